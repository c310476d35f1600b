"""COLMAP database (SQLite) with two images, their tie points as keypoints, and the pair as verified.

Keypoints have the first pixel's centre at (0.5, 0.5), in float32 as COLMAP keeps them: 0.002 px beyond column 16 000.
SAR images have no pinhole: the cameras are SIMPLE_PINHOLE with COLMAP's default focal length of 1.2 times the longer
side and no prior, so that the tie points can be looked at and passed on; a reconstruction from them means nothing.

References
----------
COLMAP documentation, Database Format, https://colmap.github.io/database.html
"""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.exports.content import Content, ImageInfo

PIXEL_OFFSET = 0.5
#: Identifiers of images are below this; pairs are numbered by it.
MOST_IMAGES = 2**31 - 1
SIMPLE_PINHOLE = 0
#: Configurations of a verified pair.
UNCALIBRATED, PLANAR = 3, 4
FOCAL = 1.2

BLOB = "rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB"
OF_IMAGE = (
    f"image_id INTEGER PRIMARY KEY NOT NULL, {BLOB}, "
    "FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE"
)
PRIOR = ", ".join(f"prior_{name} REAL" for name in ("qw", "qx", "qy", "qz", "tx", "ty", "tz"))
TABLES = {
    "cameras": "camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL, width INTEGER NOT NULL, "
    "height INTEGER NOT NULL, params BLOB, prior_focal_length INTEGER NOT NULL",
    # COLMAP up to 3.9 asks for the columns of a prior pose, which later versions leave aside.
    "images": "image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL UNIQUE, camera_id INTEGER NOT "
    f"NULL, {PRIOR}, CONSTRAINT image_id_check CHECK(image_id >= 0 AND image_id < {MOST_IMAGES}), "
    "FOREIGN KEY(camera_id) REFERENCES cameras(camera_id)",
    "keypoints": OF_IMAGE,
    "descriptors": OF_IMAGE,
    "matches": f"pair_id INTEGER PRIMARY KEY NOT NULL, {BLOB}",
    "two_view_geometries": f"pair_id INTEGER PRIMARY KEY NOT NULL, {BLOB}, config INTEGER NOT NULL, F BLOB, E BLOB, "
    "H BLOB, qvec BLOB, tvec BLOB",
}


def write(content: Content, path: Path) -> None:
    """Write images 1 (the reference) and 2 (the secondary) and the pair; H is the model's matrix where it has one."""
    images = (content.reference, content.secondary)
    points = (content.matches.reference_xy, content.matches.secondary_xy)
    count = len(content.matches)
    pairs = np.column_stack([np.arange(count)] * 2).astype("<u4")
    pair = pair_id(1, 2)
    matrix = content.model.matrix if content.model else None
    if matrix is not None:
        move = np.array([[1, 0, PIXEL_OFFSET], [0, 1, PIXEL_OFFSET], [0, 0, 1.0]])
        matrix = move @ matrix @ np.linalg.inv(move)
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        for name, columns in TABLES.items():
            database.execute(f"CREATE TABLE {name} ({columns})")
        database.execute("CREATE UNIQUE INDEX index_name ON images(name)")
        names = _names(images)
        for number, (image, xy) in enumerate(zip(images, points, strict=True), 1):
            height, width = image.size
            params = np.array([FOCAL * max(height, width, 1), width / 2, height / 2])
            row = (number, SIMPLE_PINHOLE, width, height, _blob(params, "<f8"), 0)
            database.execute("INSERT INTO cameras VALUES (?, ?, ?, ?, ?, ?)", row)
            database.execute(
                "INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, ?)", (number, names[number - 1], number)
            )
            database.execute(
                "INSERT INTO keypoints VALUES (?, ?, ?, ?)", (number, count, 2, _blob(xy + PIXEL_OFFSET, "<f4"))
            )
            database.execute("INSERT INTO descriptors VALUES (?, ?, ?, ?)", (number, 0, 128, b""))
        database.execute("INSERT INTO matches VALUES (?, ?, ?, ?)", (pair, count, 2, _blob(pairs, "<u4")))
        config = UNCALIBRATED if matrix is None else PLANAR
        geometry = None if matrix is None else _blob(matrix, "<f8")
        verified = (pair, count, 2, _blob(pairs, "<u4"), config, None, None, geometry, None, None)
        database.execute("INSERT INTO two_view_geometries VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", verified)


def pair_id(first: int, second: int) -> int:
    """Return the number of a pair of images."""
    return min(first, second) * MOST_IMAGES + max(first, second)


def _names(images: tuple[ImageInfo, ImageInfo]) -> tuple[str, str]:
    """Names relative to one folder; unlike, as the database demands."""
    # SQLite holds UTF-8 alone.
    a, b = (Path(image.path.encode(errors="backslashreplace").decode()) for image in images)
    if a.name != b.name:
        return a.name, b.name
    return f"reference/{a.name}", f"secondary/{b.name}"


def _blob(array: NDArray[Any], dtype: str) -> bytes:
    return np.ascontiguousarray(array, dtype=dtype).tobytes()
