"""Parameters of all steps (1-8): one frozen dataclass per stage, presets in YAML, and tables of all parameters.

Each parameter is declared once (:mod:`torchjoint.config.parameter`). The checks and the documents' tables read this
declaration. An unknown name or a bad value raises an error that names the parameter.
"""

from torchjoint.config.config import (
    Config,
    evidence_config,
    evidence_differences,
    presets,
    read_assignment,
    read_preset,
    read_yaml,
)
from torchjoint.config.stages import (
    DETECTORS,
    BoundaryConfig,
    ContoursConfig,
    ImageGraphConfig,
    ImageSegmentsConfig,
    PaperConfig,
    PointGraphConfig,
    PointSegmentsConfig,
    PropagationConfig,
    RefinementConfig,
    ScanConfig,
    VisibilityConfig,
)
from torchjoint.config.superpoints import SuperpointsConfig
from torchjoint.config.tables import marked_parameters, marked_table, parameter_table, superpoint_table

__all__ = [
    "DETECTORS", "BoundaryConfig", "Config", "ContoursConfig", "ImageGraphConfig", "ImageSegmentsConfig", "PaperConfig",
    "PointGraphConfig", "PointSegmentsConfig", "PropagationConfig", "RefinementConfig", "ScanConfig",
    "SuperpointsConfig", "VisibilityConfig", "evidence_config", "evidence_differences", "marked_parameters",
    "marked_table", "parameter_table", "presets", "read_assignment", "read_preset", "read_yaml", "superpoint_table",
]  # fmt: skip
