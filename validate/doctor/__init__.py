"""What this machine can do, tried and not guessed: each trial runs a small piece of the real thing in a child and says how to mend what fails.

for finding in examine_machine(Path("runs/all")):
    print(finding.name, finding.state, finding.sentence, finding.remedy)
"""

from validate.doctor.examine import MachineFinding, State, examine_machine

__all__ = ["MachineFinding", "State", "examine_machine"]
