"""Single shooting by L-BFGS through the true contact law: second-order steps on the loss of relu_gd, and the goal met by multipliers."""

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
