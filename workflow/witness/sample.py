"""The recording that ships with the documentation: a skin with one electrode two degrees from its
nominal position.

    python -m witness.sample docs/sample
"""

import sys

from witness import cases

NAME, SEED, FRAMES = "electrode-position", 1, 80
SHARE = 0.4  # of the largest shift of `strengths`, two degrees


def sample() -> cases.Case:
    """The case, equal bit for bit on one machine."""
    return cases.draw("sample", SEED, frames=FRAMES, names=[NAME], share=SHARE)


if __name__ == "__main__":
    cases.write(sample(), sys.argv[1])
