"""What `pytest --nbval` runs the notebooks with: the smallest profile, no progress bars, tables in a passing folder."""

import atexit
import os
import shutil
import tempfile

os.environ.setdefault("VIEWNET_PROFILE", "smoke")
os.environ.setdefault("TQDM_DISABLE", "1")
if "VIEWNET_TABLES" not in os.environ:
    os.environ["VIEWNET_TABLES"] = tempfile.mkdtemp(prefix="viewnet-tables-")
    atexit.register(shutil.rmtree, os.environ["VIEWNET_TABLES"], ignore_errors=True)
