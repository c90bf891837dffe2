"""`python -m viewnet` is the command `viewnet`; torchrun starts it so."""

import sys

from viewnet.cli import main

sys.exit(main())
