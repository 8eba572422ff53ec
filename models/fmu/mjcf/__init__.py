"""Export MuJoCo models (XML or URDF) as FMUs, without Modelica and Python inside.

    robot = read_robot(Path("robot.xml"), contacts=["foot:floor"])
    robot.notes  # remarks for the user
    path = build_robot(robot, version="3.0")  # with MuJoCo's library and the compiled model
    robot.map_text  # the map for `replay --fmu --map`
    Recorder(robot.model)  # records a MuJoCo simulation as a plan for that map

`equations.h` and `integrator.h` replace those of scenes; the rest is `models/fmu/shell`.
"""

from models.fmu.mjcf.export import build_robot
from models.fmu.mjcf.robot import Recorder, Robot, RobotError, read_robot

__all__ = ["Recorder", "Robot", "RobotError", "build_robot", "read_robot"]
