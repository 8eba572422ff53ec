"""A plan of three_cart by simulation in NumPy: inputs chosen by hand, the true contact law.

Written as a CSV.

python plan_from_numpy.py && python -m validate replay plan.csv --scene three_cart
"""

import numpy as np

h = 0.01
steps = 500
mass = 1.0
damping = 2.0
stiffness = 30.0
length = 0.5
t = h * np.arange(steps + 1)
q = np.zeros((steps + 1, 3))
v = np.zeros((steps + 1, 3))
u = np.zeros((steps, 2))
force = np.zeros((steps, 2))
q[0] = 2.0, 3.0, 4.0
u[:, 0] = np.where(t[:-1] < 2.0, 2.0, 0.0)
for n in range(steps):
    force[n] = stiffness * np.maximum(length - np.diff(q[n]), 0.0)  # left, right
    push = np.array([u[n, 0] - force[n, 0], force[n, 0] - force[n, 1], u[n, 1] + force[n, 1]])
    v[n + 1] = v[n] + h * (push - damping * v[n]) / mass
    q[n + 1] = q[n] + h * v[n + 1]

with open("plan.csv", "w", encoding="utf-8") as file:
    print("# scheme: semi_implicit_euler\nt,q1,q2,q3,v1,v2,v3,u1,u3,lam_left,lam_right", file=file)
    for n in range(steps + 1):
        cells = [t[n], *q[n], *v[n], *(u[n] if n < steps else ()), *(force[n] if n < steps else ())]
        print(
            ",".join(repr(float(cell)) for cell in cells) + ("" if n < steps else ",,,,"), file=file
        )
