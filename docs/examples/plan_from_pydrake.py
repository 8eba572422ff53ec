"""A plan of three_cart recorded in Drake's simulator: a hand-written controller pushes, and its motion and inputs become a CSV.

python plan_from_pydrake.py && python -m validate replay plan.csv --scene three_cart
"""

import numpy as np
from pydrake.all import (
    AddContactMaterial,
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiagramBuilder,
    PrismaticJoint,
    ProximityProperties,
    RigidTransform,
    Simulator,
    SpatialInertia,
    Sphere,
)

h = 0.01
steps = 500
stiffness = 30.0
length = 0.5
builder = DiagramBuilder()
plant, _ = AddMultibodyPlantSceneGraph(
    builder, time_step=0.0
)  # the continuous plant: its integrator controls its error
plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
# Two springs in series: each geometry has twice the stiffness of the contact.
surface = ProximityProperties()
AddContactMaterial(
    dissipation=0.0,
    point_stiffness=2 * stiffness,
    friction=CoulombFriction(0.0, 0.0),
    properties=surface,
)
joints = []
for place in range(3):
    cart = plant.AddRigidBody(f"cart{place}", SpatialInertia.SolidSphereWithMass(1.0, length / 2))
    joints.append(
        plant.AddJoint(
            PrismaticJoint(
                f"q{place}", plant.world_frame(), cart.body_frame(), [1.0, 0.0, 0.0], damping=2.0
            )
        )
    )
    plant.AddJointActuator(f"u{place}", joints[-1])
    plant.RegisterCollisionGeometry(
        cart, RigidTransform(), Sphere(length / 2), f"ball{place}", surface
    )
plant.Finalize()
diagram = builder.Build()
context = diagram.CreateDefaultContext()
carts = plant.GetMyMutableContextFromRoot(context)
plant.SetPositions(carts, [2.0, 3.0, 4.0])
simulator = Simulator(diagram, context)
simulator.get_mutable_integrator().set_target_accuracy(1e-9)
pushes = True

with open("plan.csv", "w", encoding="utf-8") as file:
    print("t,q1,q2,q3,v1,v2,v3,u1,u3", file=file)
    for n in range(steps + 1):
        q, v = plant.GetPositions(carts), plant.GetVelocities(carts)
        # A cart that is let go of glides on by m v/c, and by what the contact gives as it opens.
        pushes = pushes and q[1] + v[1] / 2.0 < 3.39
        u = np.clip(
            [
                20.0 * ((2.0 + 0.7 * n * h if pushes else 2.5) - q[0]) - 6.0 * v[0],
                20.0 * (4.5 - q[2]) - 6.0 * v[2],
            ],
            -10.0,
            10.0,
        )
        print(",".join(repr(float(number)) for number in (n * h, *q, *v, *u)), file=file)
        plant.get_actuation_input_port().FixValue(carts, [u[0], 0.0, u[1]])
        simulator.AdvanceTo((n + 1) * h)
