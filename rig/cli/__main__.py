"""``python -m lfrig.rig.cli``."""

import sys

from lfrig.rig.cli import main

sys.exit(main())
