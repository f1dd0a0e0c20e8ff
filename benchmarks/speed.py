"""Runs the measurements that need no data and at most some minutes each: `python benchmarks/speed.py`."""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SCRIPTS = ("light", "ops", "forest", "superpoints", "one_more_frame", "metrics", "mask_cost", "frame", "page")

for script in SCRIPTS:
    print(f"# {script}.py", flush=True)
    subprocess.run([sys.executable, HERE / f"{script}.py"], check=True)
