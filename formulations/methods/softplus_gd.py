"""Single shooting by gradient descent on softplus contact, with forces at a distance."""

from formulations.method import Kind
from formulations.shooting.method import DescentMethod
from models.contact_law import ContactLaw


class SoftplusGD(DescentMethod):
    """Gradient descent on softplus contact."""

    name = "softplus_gd"
    title = "Gradient descent on softplus contact"
    kind = Kind.INDIRECT
    needs_eps = True
    law = ContactLaw.SOFTPLUS


METHOD = SoftplusGD()
