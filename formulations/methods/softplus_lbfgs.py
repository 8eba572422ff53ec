"""Single shooting by L-BFGS on softplus contact, with multipliers for the goal."""

from formulations.method import Kind
from formulations.shooting.method import QuasiNewtonMethod
from models.contact_law import ContactLaw


class SoftplusLbfgs(QuasiNewtonMethod):
    """L-BFGS on softplus contact."""

    name = "softplus_lbfgs"
    title = "L-BFGS on softplus contact"
    kind = Kind.INDIRECT
    needs_eps = True
    law = ContactLaw.SOFTPLUS


METHOD = SoftplusLbfgs()
