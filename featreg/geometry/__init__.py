"""Geometric models reference -> secondary, and how to make, write and read them.

GeometricModel
├── MatrixModel
│   ├── Translation, Rigid, Similarity     numbers with a meaning
│   └── Affine, Homography                 a matrix
├── Polynomial2, Polynomial3
└── InverseModel                           of a polynomial, by iteration
"""

from featreg.geometry.base import GeometricModel, MatrixModel, decompose
from featreg.geometry.convert import as_model, local_linear, model_from_dict, model_from_matrix, model_to_dict
from featreg.geometry.homography import Homography
from featreg.geometry.matrix import Affine, Rigid, Similarity, Translation
from featreg.geometry.polynomial import InverseModel, Polynomial2, Polynomial3
from featreg.geometry.uncertainty import RigidUncertainty, prediction_covariance, regional_covariance, rigid_uncertainty

__all__ = [
    "Affine",
    "GeometricModel",
    "Homography",
    "InverseModel",
    "MatrixModel",
    "Polynomial2",
    "Polynomial3",
    "Rigid",
    "RigidUncertainty",
    "Similarity",
    "Translation",
    "as_model",
    "decompose",
    "local_linear",
    "model_from_dict",
    "model_from_matrix",
    "model_to_dict",
    "prediction_covariance",
    "regional_covariance",
    "rigid_uncertainty",
]
