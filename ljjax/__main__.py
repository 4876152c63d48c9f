"""`python -m ljjax` is the command line."""

import sys

from ljjax.cli import main

sys.exit(main())
