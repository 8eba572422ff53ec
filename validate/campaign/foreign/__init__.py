"""Prepare a campaign of foreign plans: instances of a scene, each with a plan from a file."""

from validate.campaign.foreign.instances import PlanScenes, foreign_references, plan_scenes

__all__ = ["PlanScenes", "foreign_references", "plan_scenes"]
