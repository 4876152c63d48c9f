"""`python -m ljjax.rig …` is `ljjax rig …`."""

import sys

from ljjax.cli import main

sys.exit(main(["rig", *sys.argv[1:]]))
