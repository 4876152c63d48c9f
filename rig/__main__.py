"""`python -m ljjax.rig …` is `ljjax rig …`."""

import sys

from ljjax.cli import main

if __name__ == "__main__":
    sys.exit(main(["rig", *sys.argv[1:]]))
