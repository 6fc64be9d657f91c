"""The domain that the guide shows, for tests that need one of which nothing else knows."""

import sys
from pathlib import Path

from resync_robot.sim_training.domains import find_domain

PUCK_FILE = Path(__file__).parents[1] / "docs" / "puck_behind_a_door.py"
PUCK_DOMAIN = find_domain(str(PUCK_FILE))
puck = sys.modules[PUCK_DOMAIN.classifiers["At"].__module__]
"""The module that its file is."""
