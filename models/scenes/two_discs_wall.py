"""One disc is thrown at another, which goes off a wall to the goal: `two_discs` with a wall."""

from models.scenes.two_discs import two_discs

SCENE = two_discs(wall=True, name="two_discs_wall")
