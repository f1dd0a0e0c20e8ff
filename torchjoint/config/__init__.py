"""Parameters of all steps (1-8): one frozen dataclass per stage, presets in YAML, and tables of all parameters.

Each parameter is declared once (:mod:`torchjoint.config.parameter`). The checks and the documents' tables read this
declaration. An unknown name or a bad value raises an error that names the parameter.
"""

from torchjoint_lab.regions.config import (
    ImageSupportConfig,
    OcclusionBridgingConfig,
    PiecesConfig,
    RegionMergingConfig,
)

from torchjoint.config.afterwards import evidence_config, evidence_differences
from torchjoint.config.config import STAGES, Config
from torchjoint.config.images import DETECTORS, BoundaryConfig, ContoursConfig, ImageGraphConfig, ImageSegmentsConfig
from torchjoint.config.labels import RefinementConfig
from torchjoint.config.points import PointGraphConfig, PointSegmentsConfig
from torchjoint.config.presets import presets, read_assignment, read_preset, read_yaml
from torchjoint.config.scan import ScanConfig
from torchjoint.config.superpoints import SuperpointsConfig, superpoint_presets
from torchjoint.config.tables import marked_parameters, marked_table, parameter_table, superpoint_table
from torchjoint.config.views import PropagationConfig, VisibilityConfig

__all__ = [
    "DETECTORS",
    "STAGES",
    "BoundaryConfig",
    "Config",
    "ContoursConfig",
    "ImageGraphConfig",
    "ImageSegmentsConfig",
    "ImageSupportConfig",
    "OcclusionBridgingConfig",
    "PiecesConfig",
    "PointGraphConfig",
    "PointSegmentsConfig",
    "PropagationConfig",
    "RefinementConfig",
    "RegionMergingConfig",
    "ScanConfig",
    "SuperpointsConfig",
    "VisibilityConfig",
    "evidence_config",
    "evidence_differences",
    "marked_parameters",
    "marked_table",
    "parameter_table",
    "presets",
    "read_assignment",
    "read_preset",
    "read_yaml",
    "superpoint_presets",
    "superpoint_table",
]
