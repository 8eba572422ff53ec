"""Any robot as an FMU: MuJoCo's XML (or URDF, as far as MuJoCo reads it) behind the shell of our FMUs, without Modelica and without Python inside.

    # refuses what an FMU cannot carry, in a sentence
    robot = read_robot(Path("robot.xml"), contacts=["foot:floor"])
    robot.notes                                                         # what is to be said of it
    # the FMU, with MuJoCo's library and the compiled model inside
    path = build_robot(robot, version="3.0")
    robot.map_text  # the map for `replay --fmu --map`
    Recorder(robot.model)  # records a simulation with MuJoCo itself as a plan for that map

`equations.h` and `integrator.h` stand in the place of the scenes' files of these names; all else of
the C is `models/fmu/shell`.
"""

from models.fmu.mjcf.export import build_robot
from models.fmu.mjcf.robot import Recorder, Robot, RobotError, read_robot

__all__ = ["Recorder", "Robot", "RobotError", "build_robot", "read_robot"]
