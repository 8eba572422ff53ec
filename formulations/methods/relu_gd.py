"""Single shooting by gradient descent on true contact, without gradients at a distance."""

from formulations.method import Kind
from formulations.shooting.method import DescentMethod
from models.contact_law import ContactLaw


class ReluGD(DescentMethod):
    """Gradient descent on the true contact law."""

    name = "relu_gd"
    title = "Gradient descent on ReLU contact"
    kind = Kind.DIRECT
    needs_eps = False
    law = ContactLaw.RELU


METHOD = ReluGD()
