"""Other simulators: verdicts on a plan, and errors on problems with exact answers.

answer = run_engine("mujoco", drives)  # validate.judge.engines.simulator
rows = elsewhere(judgement, ("fmu_everyday", "mujoco"))  # validate.judge.engines.elsewhere
"""
