"""What a user of the shooting package can do wrong."""

from models.errors import TouchstoneError


class ShootingError(TouchstoneError):
    """Tensors that the compiled rollout cannot take, or a derivative that it does not have."""
