"""Geometric models reference -> secondary, and how to make, write and read them.

Model
├── MatrixModel
│   ├── Translation, Rigid, Similarity     numbers with a meaning
│   └── Affine, Homography                 a matrix
├── Polynomial2, Polynomial3
├── InverseModel                           of a polynomial, by iteration
├── ResidualField                          affine and a smooth local residual
└── CorrectedModel                         a known map and a correction, `RpcBias` for example
"""

from featreg.geometry.base import MatrixModel, decompose
from featreg.geometry.cells import dilution, rigid_standard_errors, selection_cut, spread
from featreg.geometry.convert import as_model, local_linear, model_from_dict, model_from_matrix, model_to_dict
from featreg.geometry.corrected import CorrectedModel
from featreg.geometry.correlated import Predicted, correlated_covariance, prediction
from featreg.geometry.homography import Homography
from featreg.geometry.matrix import Affine, Rigid, Similarity, Translation
from featreg.geometry.polynomial import InverseModel, Polynomial2, Polynomial3
from featreg.geometry.residual_field import ResidualField
from featreg.geometry.skimage_transforms import from_skimage, to_skimage
from featreg.geometry.uncertainty import (
    RigidUncertainty,
    inverse_variances,
    prediction_covariance,
    refitted_covariance,
    regional_covariance,
    rigid_uncertainty,
)

__all__ = [
    "Affine",
    "CorrectedModel",
    "Homography",
    "InverseModel",
    "MatrixModel",
    "Polynomial2",
    "Polynomial3",
    "Predicted",
    "ResidualField",
    "Rigid",
    "RigidUncertainty",
    "Similarity",
    "Translation",
    "as_model",
    "correlated_covariance",
    "decompose",
    "dilution",
    "from_skimage",
    "inverse_variances",
    "local_linear",
    "model_from_dict",
    "model_from_matrix",
    "model_to_dict",
    "prediction",
    "prediction_covariance",
    "refitted_covariance",
    "regional_covariance",
    "rigid_standard_errors",
    "rigid_uncertainty",
    "selection_cut",
    "spread",
    "to_skimage",
]
