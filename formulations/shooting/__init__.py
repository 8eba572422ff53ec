"""Single shooting: the plan is its inputs, everything else follows by simulation, and a loss of them is made small.

    from formulations.shooting.rollout import rollout
    u = torch.zeros(500, 2, dtype=torch.float64, requires_grad=True)
    q, v, lam, cost = rollout(scene, u)                 # compiled time step, C adjoint behind it
    loss = (q[-1] - target).square().mean() + 5e-6 * cost
    loss.backward()

Leading dimensions are plans of their own, so that many starts descend in one loop of the user's own:

    u = torch.randn(64, 500, 2, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.SGD([u], lr=500.0)
    loss = plan_loss(rollout(scene, u), goal, Weights())    # (64,)
    loss.sum().backward()

rollout     the simulation as a differentiable PyTorch function, for any loss of one's own
reference   the same in plain PyTorch, slow and simple: what the compiled one is tested against, and what runs on a GPU
objective   the paper's loss as one fast function, and its gradient
compiled    the same, its mean over random inputs, and the loop of gradient descent in C (loss.c)
descent     gradient descent by that loop: options, limits, and the words at its end
stopping    its stopping rule
diagnosis   why a descent cannot go on, in numbers: dead contacts, growth over the horizon, a rate that would do
quasi_newton   L-BFGS within the bounds of the inputs, and the goal met by multipliers
smoothed    the loss averaged over random inputs
growth      how fast gradients grow on their way back over the horizon

PyTorch lives in rollout and reference only, for users' own losses: it takes seconds to import, and the methods do without it.
"""
