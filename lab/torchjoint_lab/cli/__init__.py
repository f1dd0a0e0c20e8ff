"""The commands of torchjoint-lab, one file each."""
