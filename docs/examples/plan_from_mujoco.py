"""A plan of three_cart recorded in MuJoCo: a hand-written controller pushes, and its motion and inputs become a CSV.

python plan_from_mujoco.py && python -m validate replay plan.csv --scene three_cart --engine mujoco
"""

import mujoco
import numpy as np

# inputs are held for h; MuJoCo makes ten steps in it
h = 0.01
steps = 500
parts = 10
cart = '<body><joint name="q{0}" type="slide" axis="1 0 0" damping="2"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
# A contact of 30 N/m between carts 0.5 m long: a tendon as long as the distance of their centres,
# which pushes where that is shorter.
contact = '<fixed stiffness="30" springlength="0.5 1e6"><joint joint="q{0}" coef="-1"/><joint joint="q{1}" coef="1"/></fixed>'
model = mujoco.MjModel.from_xml_string(
    f'<mujoco><option integrator="RK4" gravity="0 0 0" timestep="{h / parts}"/><worldbody>{"".join(map(cart.format, (1, 2, 3)))}</worldbody>'
    f"<tendon>{contact.format(1, 2)}{contact.format(2, 3)}</tendon></mujoco>"
)
data = mujoco.MjData(model)
data.qpos[:] = 2.0, 3.0, 4.0
pushes = True

with open("plan.csv", "w", encoding="utf-8") as file:
    print("t,q1,q2,q3,v1,v2,v3,u1,u3", file=file)
    for n in range(steps + 1):
        q, v = data.qpos, data.qvel
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
        data.qfrc_applied[[0, 2]] = u
        mujoco.mj_step(model, data, parts)
