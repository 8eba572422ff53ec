"""One disc is thrown at another, which then goes off a wall towards the goal: `two_discs` with its wall at y = 1."""

from models.scenes.two_discs import two_discs

SCENE = two_discs(wall=True, name="two_discs_wall")
