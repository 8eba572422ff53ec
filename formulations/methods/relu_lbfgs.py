"""Single shooting by L-BFGS on the true contact law, with multipliers for the goal."""

from formulations.method import Kind
from formulations.shooting.method import QuasiNewtonMethod
from models.contact_law import ContactLaw


class ReluLbfgs(QuasiNewtonMethod):
    """L-BFGS on the true contact law."""

    name = "relu_lbfgs"
    title = "L-BFGS on ReLU contact"
    kind = Kind.DIRECT
    needs_eps = False
    law = ContactLaw.RELU


METHOD = ReluLbfgs()
