"""`python -m resync_robot` is `resync-robot`."""

import sys

from resync_robot.cli import main

sys.exit(main())
