"""Runs all speed measurements: `python benchmarks/speed.py [FOLDER]`; FOLDER is a recording for frame.py."""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent

for script, arguments in (("ops.py", []), ("superpoints.py", []), ("metrics.py", []), ("frame.py", sys.argv[1:])):
    print(f"# {script}", flush=True)
    subprocess.run([sys.executable, HERE / script, *arguments], check=True)
