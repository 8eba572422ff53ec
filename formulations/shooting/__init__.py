"""Single shooting: the plan is its inputs, everything else follows by simulation, and a loss of them is made small, in PyTorch.

    from formulations.shooting.rollout import rollout
    u = torch.zeros(500, 2, dtype=torch.float64, requires_grad=True)
    plan = rollout(scene, u)                            # compiled time step, C adjoint behind it
    loss = (plan.end - goal).square().mean() + 5e-6 * plan.cost
    loss.backward()

Leading dimensions are plans of their own, so that many starts descend in one loop:

    u = torch.randn(64, 500, 2, dtype=torch.float64, requires_grad=True)
    # loss (64,)
    for _, loss in zip(range(100), projected_descent(lambda u: GoalLoss(goal)(rollout(scene, u), u), u, 500.0, lower, upper)): ...

rollout     the simulation as a differentiable PyTorch function
reference   the same in plain PyTorch, slow and simple: what the compiled one is tested against, and
            what runs on a GPU
objective   a loss of the inputs: the paper's, or one's own, or its mean over random inputs
descent     gradient descent: its limits, its stopping rule, and its messages; why a descent cannot
            go on, in numbers: dead contacts,
            growth over the horizon, a rate that would do
quasi_newton   L-BFGS within the bounds of the inputs, and the goal met by multipliers
stage       warm start and plan of a stage, its residuals and seconds, and how fast gradients grow
            on their way back over its horizon
session     a method opened on a scene; method: what the methods share beside it; options: of both
            kinds
"""
