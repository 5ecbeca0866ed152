"""The recording that ships with the documentation: a skin one of whose electrodes sits two degrees
from where its owner's drawing has it.

    python -m witness.sample docs/sample
"""

import sys

from witness import cases

NAME, SEED, FRAMES = "electrode-position", 1, 80
SHARE = 0.4  # of the largest shift that is drawn


def sample() -> cases.Case:
    """The case, the same bit for bit on one machine."""
    return cases.draw("sample", SEED, frames=FRAMES, names=[NAME], share=SHARE)


if __name__ == "__main__":
    cases.write(sample(), sys.argv[1])
