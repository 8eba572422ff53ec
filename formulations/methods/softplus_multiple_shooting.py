"""Multiple shooting on softplus contact, for unstable scenes: errors grow over one step only."""

from formulations.method import Kind
from formulations.multiple_shooting.method import MultipleShootingMethod
from models.contact_law import ContactLaw


class SoftplusMultipleShooting(MultipleShootingMethod):
    """Multiple shooting on softplus contact."""

    name = "softplus_multiple_shooting"
    title = "Multiple shooting on softplus contact"
    kind = Kind.INDIRECT
    needs_eps = True
    law = ContactLaw.SOFTPLUS


METHOD = SoftplusMultipleShooting()
