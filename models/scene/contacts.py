"""Contacts and dry friction of a scene.

    Contact(name="left", bodies=("left", "middle"), penetration=d - (q2 - q1), stiffness=k, depth=d, depth_reason="the carts' length")
    Contact(name="pad", .., damping=c)  # Kelvin-Voigt, c [N s/m]
    Contact(name="ball", .., damping=d, damping_law=DampingLaw.HUNT_CROSSLEY)   # d [s/m]
    # pressed by the force of the contact "left"
    Friction(name="left", slip=v1 - v2, coefficient=mu, contact="left")
    # pressed by a given force
    Friction(name="belt", slip=v_cargo - v_cart, coefficient=mu, normal_force=m * g)

Friction acts in the plane: one tangential direction, Coulomb's law. The slip speed is s = S(q) v,
the pressing force N >= 0. The friction force f acts as the generalised force S' f and obeys maximal
dissipation: f minimises f s over |f| <= mu N. So f = -mu N sign(s) if the contact slips. If the
contact sticks, s = 0 and f is the force that keeps it there.

Damping is part of the normal force. With the penetration phi and its rate phi' = -J v:

    Kelvin-Voigt     lam = max(k phi + c phi', 0)     if phi > 0, else 0
    Hunt-Crossley    lam = k phi max(1 + d phi', 0)   if phi > 0, else 0

Neither law pulls: a contact that opens faster than its spring follows has lam = 0 before phi is 0.
The force of Kelvin-Voigt jumps to c phi' at touch-down; that of Hunt-Crossley is continuous. The
spring stores k/2 max(phi, 0)^2, and (lam - k max(phi, 0)) phi' >= 0 is dissipated.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import sympy as sp

from models.errors import SceneError
from models.scene.values import (
    as_expression,
    as_number,
    check_name,
    check_text,
    named_fields,
    settle,
)


class DampingLaw(Enum):
    """The law of a damped contact; see the module docstring.

    The value is the number of the law in the generated C.
    """

    KELVIN_VOIGT = 1
    HUNT_CROSSLEY = 2

    @property
    def unit(self) -> str:
        """Return the unit of the coefficient."""
        return "N s/m" if self is DampingLaw.KELVIN_VOIGT else "s/m"


@named_fields
@dataclass(frozen=True, kw_only=True)
class Contact:
    """One unilateral contact: lam = stiffness * max(penetration, 0), which pushes the bodies apart.

    Attributes
    ----------
    name
        Letters, digits and _; the force in a plan is lam_NAME.
    penetration
        phi(q) [m], of positions and parameters; positive in contact, smooth.
    stiffness
        k [N/m], of parameters; positive.
    damping
        Coefficient, of parameters, in the unit of `damping_law`, never negative; 0: no damping.
    damping_law
        KELVIN_VOIGT (damping in N s/m) or HUNT_CROSSLEY (damping in s/m).
    bodies
        The two bodies, by the names of their shapes; "ground", "wall" or "joint" may be one of
        them; must be given.
    depth
        Penetration at which the model ends [m], of parameters; a plan that goes deeper does not hold;
        must be given.
    depth_reason
        Reason why the model ends there; must be given.
    nominal
        Typical penetration [m], positive; the stability of the step is checked there.
    description
        Shown in reports and in the FMU.
    """

    name: str
    penetration: sp.Expr
    stiffness: sp.Expr
    damping: sp.Expr = sp.S.Zero
    damping_law: DampingLaw = DampingLaw.KELVIN_VOIGT
    bodies: tuple[str, str] = ("", "")
    depth: sp.Expr = sp.S.Zero  # a number becomes one
    depth_reason: str = ""
    nominal: float = 1e-2
    description: str = ""

    def __post_init__(self) -> None:
        check_name("contact", self.name)
        needed = {
            "bodies": self.bodies != ("", ""),
            "depth": self.depth != 0,
            "depth_reason": self.depth_reason,
        }
        missing = [name for name, given in needed.items() if not given]
        if missing:
            raise SceneError(
                f"contact {self.name}: {', '.join(missing)} must be given: between which bodies it acts and how deep they may press into each other "
                f'before the model ends; for example bodies=("cart", "wall"), depth=0.1, depth_reason="the length of the spring".'
            )
        if (
            not isinstance(self.bodies, (tuple, list))
            or len(self.bodies) != 2
            or self.bodies[0] == self.bodies[1]
        ):
            raise SceneError(
                f"contact {self.name}: bodies must be the names of two different bodies, not {self.bodies!r}."
            )
        settle(self, "bodies", tuple(self.bodies))
        for body in self.bodies:
            check_text(f"contact {self.name}: bodies", body)
        check_text(f"contact {self.name}: depth_reason", self.depth_reason)
        for field in ("penetration", "stiffness", "damping", "depth"):
            settle(
                self, field, as_expression(f"contact {self.name}: {field}", getattr(self, field))
            )
        settle(self, "nominal", as_number(f"contact {self.name}: nominal", self.nominal))
        if self.nominal <= 0:
            raise SceneError(
                f"contact {self.name}: nominal (a typical penetration in m) must be positive, not {self.nominal:g}."
            )
        if not isinstance(self.damping_law, DampingLaw):
            known = " or ".join(str(law) for law in DampingLaw)
            raise SceneError(
                f"contact {self.name}: damping_law must be {known}, not {self.damping_law!r}."
            )

    @property
    def is_damped(self) -> bool:
        """Return whether the coefficient of damping is not 0."""
        return self.damping != 0

    @property
    def pressing_name(self) -> str:
        """Return the name of the FMU's variable that is true if the contact presses."""
        return f"pressing_{self.name}"

    @property
    def force_name(self) -> str:
        """Return the name of the contact force, as in the columns of a plan."""
        return f"lam_{self.name}"

    @property
    def gap_name(self) -> str:
        """Return the name of the gap."""
        return f"gap_{self.name}"


@named_fields
@dataclass(frozen=True, kw_only=True)
class Friction:
    """Coulomb friction in one tangential direction: |f| <= mu N; f = -mu N sign(slip) in slip.

    Attributes
    ----------
    name
        Letters, digits and _; the force in a plan is friction_NAME.
    slip
        Speed of the surfaces on each other [m/s], linear in the velocities.
    coefficient
        mu [-], of parameters; never negative.
    contact
        Name of the contact that presses the surfaces together; a tuple of names: their sum.
    normal_force
        The pressing force instead of a contact [N], of positions and parameters; never negative.
    nominal
        Typical slip speed [m/s], positive: slower slip counts as sticking in regularised friction.
    description
        Shown in reports and in the FMU.
    """

    name: str
    slip: sp.Expr
    coefficient: sp.Expr
    contact: str | tuple[str, ...] | None = None
    normal_force: sp.Expr | None = None
    nominal: float = 0.1
    description: str = ""

    def __post_init__(self) -> None:
        check_name("friction", self.name)
        where = f"friction {self.name}"
        for field in ("slip", "coefficient"):
            settle(self, field, as_expression(f"{where}: {field}", getattr(self, field)))
        if (self.contact is None) == (self.normal_force is None):
            raise SceneError(
                f"{where}: what presses the surfaces together must be given once, as contact (the name of a contact) or as "
                f"normal_force (an expression in N); there {'is neither' if self.contact is None else 'are both'}."
            )
        for name in self.pressing:
            check_name(f"{where}: contact (a name, or a tuple of names)", name)
        if isinstance(self.contact, list):
            settle(self, "contact", tuple(self.contact))
        if self.normal_force is not None:
            settle(self, "normal_force", as_expression(f"{where}: normal_force", self.normal_force))
        settle(self, "nominal", as_number(f"{where}: nominal", self.nominal))
        if self.nominal <= 0:
            raise SceneError(
                f"{where}: nominal (a typical slip speed in m/s) must be positive, not {self.nominal:g}."
            )

    @property
    def pressing(self) -> tuple[str, ...]:
        """Return the names of the contacts that press the surfaces; () for a normal force."""
        if self.contact is None:
            return ()
        return tuple(self.contact) if isinstance(self.contact, (tuple, list)) else (self.contact,)

    @property
    def force_name(self) -> str:
        """Return the name of the friction force, as in the columns of a plan."""
        return f"friction_{self.name}"

    @property
    def slip_name(self) -> str:
        """Return the name of the slip."""
        return f"slip_{self.name}"
