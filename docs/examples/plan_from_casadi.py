"""A plan of three_cart by CasADi and Ipopt: contact as complementarity, relaxed and tightened step by step, written as a CSV.

pip install casadi; python plan_from_casadi.py && python -m validate replay plan.csv --scene
three_cart
"""

import casadi as ca
import numpy as np

h = 0.01
steps = 500
damping = 2.0
stiffness = 30.0
length = 0.5
opti = ca.Opti()
q = opti.variable(3, steps + 1)
v = opti.variable(3, steps + 1)
u = opti.variable(2, steps)
force = opti.variable(2, steps)
eps = opti.parameter()
now = slice(0, steps)
after = slice(1, steps + 1)

push = ca.vertcat(u[0, :] - force[0, :], force[0, :] - force[1, :], u[1, :] + force[1, :])
opti.subject_to(v[:, after] == v[:, now] + h * (push - damping * v[:, now]))
opti.subject_to(q[:, after] == q[:, now] + h * v[:, after])
depth = ca.vertcat(length - (q[1, now] - q[0, now]), length - (q[2, now] - q[1, now]))
slack = force - stiffness * depth  # force >= 0, slack >= 0, one of them zero
opti.subject_to(ca.vec(force) >= 0)
opti.subject_to(ca.vec(slack) >= 0)
opti.subject_to(ca.vec(force * slack) <= eps)
opti.subject_to(opti.bounded(-10, ca.vec(u), 10))
opti.subject_to(ca.vertcat(q[:, 0], v[:, 0]) == ca.vertcat(2, 3, 4, 0, 0, 0))
opti.subject_to(ca.vertcat(q[:, steps], v[:, steps]) == ca.vertcat(2.5, 3.5, 4.5, 0, 0, 0))
opti.minimize(ca.sumsqr(u))
opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "max_iter": 2000, "sb": "yes"})
opti.set_initial(q, np.linspace([2, 3, 4], [2.5, 3.5, 4.5], steps + 1).T)
opti.set_initial(force, 0.1)
for value in (1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10):
    opti.set_value(eps, value)
    solution = opti.solve()
    for variable in (q, v, u, force):
        opti.set_initial(variable, solution.value(variable))
q, v, u, force = (solution.value(variable).T for variable in (q, v, u, force))

with open("plan.csv", "w", encoding="utf-8") as file:
    print("# scheme: semi_implicit_euler\nt,q1,q2,q3,v1,v2,v3,u1,u3,lam_left,lam_right", file=file)
    for n in range(steps + 1):
        cells = [
            h * n,
            *q[n],
            *v[n],
            *(u[n] if n < steps else ()),
            *(force[n] if n < steps else ()),
        ]
        print(
            ",".join(repr(float(cell)) for cell in cells) + ("" if n < steps else ",,,,"), file=file
        )
