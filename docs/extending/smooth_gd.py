"""softplus_gd with another loss: reach the goal with small changes of the inputs."""

from formulations.method import Leg, Pipeline
from formulations.methods.softplus_gd import SoftplusGD


class SmoothGD(SoftplusGD):
    name, title = "smooth_gd", "Gradient descent to smooth inputs"

    def loss(self, scene):
        # Imported here because PyTorch takes seconds to import.
        from formulations.shooting.objective import GoalLoss, Weights

        to_goal = GoalLoss(scene.task.goal, Weights(running=0.0))

        def smooth(plan, u):
            return to_goal(plan, u) + 1e-3 * u.diff(dim=-2).square().mean((-2, -1))

        return smooth


METHOD = SmoothGD()
PIPELINE = Pipeline(
    name="smooth_gd",
    title="Smooth inputs",
    legs=(Leg(method="smooth_gd", schedule=(1e-2,), options={"iterations": 500}),),
)
