"""Drake's plant of a scene, shared by the Drake engines.

Bodies come from MJCF, contacts are points between balls and half-spaces, everything else is an
applied force. Both bodies of a pair have twice the contact's stiffness, as Drake puts them in
series. Only SAP supports Kelvin-Voigt damping, the other integrators only Hunt-Crossley.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from models.scene.contacts import DampingLaw
from validate.judge.engines.adapters._mechanism import Mechanism, Touch, mechanism_of
from validate.judge.engines.simulator import CannotExpressError, Drive

drake: Any = importlib.import_module("pydrake.all")  # dynamic: pyright may lack the package

# Slip of full regularised friction [m/s]; Drake's default is 1e-3.
STICTION = 1e-4
# Inertia of massless bodies.
_TINY = 1e-12
_SYMBOLIC = {name: getattr(drake, name) for name in ("sin", "cos", "sqrt", "exp", "log")} | {
    "Max": drake.max
}


class Plant:
    """A scene in Drake: discrete (SAP) with a time step [s], else continuous."""

    def __init__(self, drive: Drive, *, time_step: float = 0.0) -> None:
        mechanism = mechanism_of(drive.scene, weights=True)
        builder, names = (
            drake.DiagramBuilder(),
            [coordinate.name for coordinate in drive.scene.coordinates],
        )
        config = drake.MultibodyPlantConfig(
            time_step=time_step, contact_model="point", discrete_contact_approximation="sap",
            use_sampled_output_ports=False,
            stiction_tolerance=STICTION, sap_near_rigid_threshold=0.0,
        )  # fmt: skip
        self.plant, graph = drake.AddMultibodyPlant(config, builder)
        (instance,) = drake.Parser(self.plant).AddModelsFromString(
            f'<mujoco model="scene"><worldbody>{mechanism.bodies}</worldbody></mujoco>', "xml"
        )
        self.plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -mechanism.gravity])
        pairs = [
            self._pads(touch, time_step > 0.0) for touch in mechanism.touches if not touch.stops
        ]
        self.plant.Finalize()
        filters = graph.collision_filter_manager()
        filters.Apply(
            drake.CollisionFilterDeclaration().ExcludeWithin(
                drake.GeometrySet([pad for pair in pairs for pad in pair])
            )
        )
        for one, other in pairs:
            filters.Apply(
                drake.CollisionFilterDeclaration().AllowBetween(
                    drake.GeometrySet(one), drake.GeometrySet(other)
                )
            )
        joints = [self.plant.GetJointByName(name) for name in names]
        self._q, self._v = (
            [getattr(joint, part)() for joint in joints]
            for part in ("position_start", "velocity_start")
        )
        self._joints, self._back = mechanism.joints, np.linalg.inv(mechanism.joints)
        forces = self._forces(mechanism)
        builder.AddSystem(forces)
        parts = builder.AddSystem(
            drake.Multiplexer([self.plant.num_multibody_states(), max(1, drive.scene.nu)])
        )
        builder.Connect(self.plant.get_state_output_port(), parts.get_input_port(0))
        builder.Connect(parts.get_output_port(0), forces.get_input_port())
        builder.Connect(
            forces.get_output_port(), self.plant.get_applied_generalized_force_input_port()
        )
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self._own, self._inputs = (
            self.plant.GetMyMutableContextFromRoot(self.context),
            parts.GetMyMutableContextFromRoot(self.context),
        )
        self._port = parts.get_input_port(1)
        for body in map(self.plant.get_body, self.plant.GetBodyIndices(instance)):
            if body.default_mass() == 0.0:  # between two joints of one body; CENIC requires mass
                body.SetSpatialInertiaInBodyFrame(
                    self._own, drake.SpatialInertia.SolidSphereWithMass(_TINY, 1.0)
                )
        q, v = self.plant.GetPositions(self._own), self.plant.GetVelocities(self._own)
        q[self._q], v[self._v] = (self._joints @ part for part in np.split(drive.start, 2))
        for name, _, start in mechanism.weights:
            q[self.plant.GetJointByName(name).position_start()] = start
        self.plant.SetPositionsAndVelocities(self._own, np.concatenate([q, v]))
        self.drive_by(np.zeros(drive.scene.nu))

    def _pads(self, touch: Touch, linear: bool) -> list[Any]:
        """Return both geometries of a contact; linear: Kelvin-Voigt damping, else Hunt-Crossley."""
        if touch.pads is None:
            raise CannotExpressError(f"contact {touch.name}: {touch.why}")
        if touch.damping and (touch.law is DampingLaw.KELVIN_VOIGT) is not linear:
            supported = "Kelvin-Voigt" if linear else "Hunt-Crossley"
            raise CannotExpressError(
                f"contact {touch.name}: this plant supports only {supported} damping"
            )
        geometries, across = [], sum(pad.radius for pad in touch.pads)
        for place, pad in enumerate(touch.pads):
            # Drake combines both in series, so balls deform in proportion to their radii.
            share = pad.radius / across if all(each.radius for each in touch.pads) else 0.5
            properties = drake.ProximityProperties()
            dissipation = None if linear else touch.damping * touch.steepness
            drake.AddContactMaterial(
                dissipation=dissipation,
                point_stiffness=touch.stiffness * touch.steepness**2 / share,
                friction=drake.CoulombFriction(touch.friction, touch.friction),
                properties=properties,
            )  # fmt: skip
            if linear:  # relaxation times of a pair add
                properties.AddProperty(
                    "material", "relaxation_time", touch.damping / touch.stiffness / 2.0
                )
            body = self.plant.GetBodyByName(pad.body) if pad.body else self.plant.world_body()
            shape, pose = drake.Sphere(pad.radius), drake.RigidTransform(list(pad.at))
            if not pad.radius:
                shape, pose = (
                    drake.HalfSpace(),
                    drake.HalfSpace.MakePose(list(pad.normal), list(pad.at)),
                )
            geometries.append(
                self.plant.RegisterCollisionGeometry(
                    body, pose, shape, f"{touch.name}_{place}", properties
                )
            )
        return geometries

    def _forces(self, mechanism: Mechanism) -> Any:
        nu = len(mechanism.symbols[2])
        sizes = {"q": self.plant.num_positions(), "v": self.plant.num_velocities(), "u": max(1, nu)}
        q, v, u = (drake.MakeVectorVariable(size, letter) for letter, size in sizes.items())
        output = [drake.Expression(0.0)] * len(v)
        for place, force in zip(
            self._v,
            mechanism.smooth([_SYMBOLIC], stops=True)(*q[self._q], *v[self._v], *u[:nu]),
            strict=True,
        ):
            output[place] = drake.Expression() + force
        for name, weight, _ in mechanism.weights:
            output[self.plant.GetJointByName(name).velocity_start()] = drake.Expression(weight)
        # Drake requires derivatives in continuous time and fails without a state: a constant one.
        still = drake.Variable("still")
        return drake.SymbolicVectorSystem(
            state=[still], input=[*q, *v, *u], dynamics=[drake.Expression(0.0)], output=output
        )

    def drive_by(self, u: np.ndarray) -> None:
        """Apply the inputs (nu,) [N, N m]. Raises nothing."""
        self._port.FixValue(self._inputs, u if len(u) else np.zeros(1))

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the scene's q and v, (nq,) each [m, rad, m/s, rad/s]. Raises nothing."""
        return self._back @ self.plant.GetPositions(self._own)[
            self._q
        ], self._back @ self.plant.GetVelocities(self._own)[self._v]

    def advance(self, scheme: str, drive: Drive) -> Any:
        """Return `advance` for `stepped` by an integrator with error control."""
        simulator = drake.Simulator(self.diagram, self.context)
        integrator = drake.ResetIntegratorFromFlags(simulator, scheme, drive.step * drive.parts)
        integrator.set_target_accuracy(drive.tolerance)
        simulator.Initialize()

        def advance(
            u: np.ndarray, slope: np.ndarray, count: int, h: float
        ) -> tuple[np.ndarray, np.ndarray]:
            """Return q, v (nq,) [m, rad, m/s, rad/s] after count h [s]; NaN if Drake fails.

            u: (nu,) [N, N m]. Raises nothing.
            """
            pieces, begin = count if slope.any() else 1, self.context.get_time()
            try:
                for part in range(pieces):
                    self.drive_by(u + slope * h * count * (part + 0.5) / pieces)
                    simulator.AdvanceTo(begin + h * count * (part + 1) / pieces)
            except RuntimeError:  # step size below its minimum
                return np.full(len(self._q), np.nan), np.full(len(self._q), np.nan)
            return self.state()

        return advance
