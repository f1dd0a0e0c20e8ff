"""The import, and one small joint scene, for asv."""

import subprocess
import sys

import torchjoint as tj


class Import:
    """A new process with torch that imports the package, and one that also gets the segmenter."""

    def time_import(self) -> None:
        subprocess.run([sys.executable, "-c", "import torch, torchjoint"], check=True)

    def time_import_of_the_segmenter(self) -> None:
        subprocess.run([sys.executable, "-c", "import torchjoint; torchjoint.JointSegmenter"], check=True)


class Joint:
    """Points and images of a small generated room to labels."""

    def setup(self) -> None:
        self.scene = tj.synthetic.make_scene(0, "small").scene

    def time_joint(self) -> None:
        tj.JointSegmenter()(self.scene)

    def peakmem_joint(self) -> None:
        tj.JointSegmenter()(self.scene)
