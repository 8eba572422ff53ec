"""Single shooting: minimise a loss of the inputs through the simulated motion, in PyTorch.

    u = torch.zeros(500, 2, dtype=torch.float64, requires_grad=True)
    plan = rollout(scene, u)  # compiled time step with C adjoint
    loss = (plan.end - goal).square().mean() + 5e-6 * plan.cost
    loss.backward()

Leading dimensions of u are separate plans. `rollout` is the compiled simulation, `reference` the
same in plain PyTorch; `objective` the loss; `descent` and `quasi_newton` the optimisers; `stage`,
`session`, `method` and `options` the method's interface.
"""
