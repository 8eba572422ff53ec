"""Single shooting: the plan is its inputs, everything else follows by simulation, and the loss is descended by PyTorch.

    from formulations.shooting.rollout import rollout
    u = torch.zeros(500, 2, dtype=torch.float64, requires_grad=True)
    q, v, lam, cost = rollout(scene, u)                 # compiled time step, C adjoint behind it
    loss = (q[-1] - target).square().mean() + 5e-6 * cost
    loss.backward()

rollout     the simulation as a differentiable PyTorch function, for any loss of one's own
reference   the same in plain PyTorch, slow and simple: what the compiled one is tested against
objective   the paper's loss, as PyTorch operations and as one fast function
descent     stochastic gradient descent's loop (without the stochastic) and its stopping rule
diagnosis   why a descent cannot go on, in numbers: dead contacts, growth over the horizon, a rate that would do
quasi_newton   L-BFGS within the bounds of the inputs, and the goal met by multipliers
smoothed    the loss averaged over random inputs
growth      how fast gradients grow on their way back over the horizon (no PyTorch; ending.py neither)

PyTorch lives in this package only. Nothing here is imported until a method is opened: PyTorch takes seconds to import.
"""
