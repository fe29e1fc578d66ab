"""A training that is killed in the middle, as by a machine that runs out of memory.

``python train_and_die.py FOLDER STEP`` is killed right after that step.
"""

import os
import signal
import sys
from pathlib import Path

from drawn_lessons import lesson

from slgaussian.semantic.branch import Architecture
from slgaussian.semantic.training import Progress, TrainingSettings, train

LESSONS = [lesson(seed) for seed in range(3)]
SETTINGS = TrainingSettings(architecture=Architecture(widths=(4, 8), hidden=8), steps=8, every=3)

if __name__ == "__main__":

    def die(progress: Progress) -> None:
        if progress.step == int(sys.argv[2]):
            os.kill(os.getpid(), signal.SIGKILL)

    train(LESSONS, SETTINGS, Path(sys.argv[1]), progress=die)
