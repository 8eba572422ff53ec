"""Multiple shooting on true contact, for unstable scenes: errors grow over one step only."""

from formulations.method import Kind
from formulations.multiple_shooting.method import MultipleShootingMethod
from models.contact_law import ContactLaw


class ReluMultipleShooting(MultipleShootingMethod):
    """Multiple shooting on the true contact law."""

    name = "relu_multiple_shooting"
    title = "Multiple shooting on ReLU contact"
    kind = Kind.DIRECT
    needs_eps = False
    law = ContactLaw.RELU


METHOD = ReluMultipleShooting()
