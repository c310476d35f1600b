"""Phase histories from files: MATLAB files of the Gotcha data set, and CPHD."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.focusing.phase_history import UNEVEN, PhaseHistory, azimuth_offsets
from featreg.io.mat_structure import check_mat
from featreg.types import FloatArray, read_only

POLARISATIONS = ("HH", "HV", "VH", "VV")


def read_phase_history(
    paths: str | Path | Iterable[str | Path],
    *,
    azimuth: tuple[float, float] | None = None,
    polarisation: str | None = None,
) -> PhaseHistory:
    """Read the phase history of one collection.

    Parameters
    ----------
    paths : one file, several, or a folder: MATLAB files of the AFRL Gotcha data set (all ``.mat`` files of a folder),
        or CPHD files, which need the extra ``featreg[sicd]``
    azimuth : (start, stop) in degrees, see `PhaseHistory.select`; None reads every pulse
    polarisation : "HH", "HV", "VH" or "VV": files of another one, by their name, are left out, and a CPHD channel of
        that one is taken; None needs files of one polarisation and CPHD of one channel

    Returns
    -------
    PhaseHistory
        Pulses in the order of the file names, or from `azimuth` start on. For CPHD: about the first reference point,
        x to the east, y to the north, z up.

    Raises
    ------
    InputError
        A file is missing, is not of these kinds, lacks a field, or holds no pulse of that azimuth or polarisation.
    PluginUnavailableError
        A CPHD file, and the extra ``sicd`` is not installed.

    Notes
    -----
    Gotcha files keep positions and r0 as float32: at 10 km, r0 is rounded by up to 0.7 mm, 0.3 rad of two-way phase
    from pulse to pulse, which blurs. Where r0 is the distance |p| but for that rounding, |p| is computed afresh: the
    rounding of p itself is harmless, because the same p stands in both ranges of the signal model.

    References
    ----------
    C. H. Casteel et al., A challenge problem for 2D/3D imaging of targets from a volumetric data set in an urban
    environment, Proc. SPIE 6568, 2007, doi:10.1117/12.731457
    """
    if polarisation is not None and polarisation not in POLARISATIONS:
        raise ParameterError(f"polarisation must be one of {', '.join(POLARISATIONS)}, got {polarisation!r}")
    if azimuth is not None and np.shape(azimuth) != (2,):
        raise ParameterError(f"azimuth must be two numbers in degrees, got {azimuth!r}")
    files = _files(paths, polarisation)
    parts = []
    for path in files:
        whole = _read_cphd(path, polarisation) if path.suffix.lower() == ".cphd" else _read_gotcha(path)
        if azimuth is not None:
            offset, width = azimuth_offsets(whole.azimuth_deg, *azimuth)
            if not (offset < width).any():
                continue
            whole = whole.select(*azimuth)  # at once, so that a long collection never stands in memory whole
        parts.append(whole)
    if not parts:
        raise InputError(f"none of {len(files)} files ({files[0]} ...) holds a pulse of azimuth {azimuth}")
    joined = PhaseHistory.concatenate(parts)
    return joined if azimuth is None else joined.select(*azimuth)


def _files(paths: str | Path | Iterable[str | Path], polarisation: str | None) -> list[Path]:
    try:
        given = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    except TypeError as error:
        raise InputError(f"the paths of phase-history files are needed, got {paths!r}") from error
    files = [file for path in given for file in (sorted(path.glob("*.mat")) if path.is_dir() else [path])]
    if polarisation is not None:
        files = [file for file in files if _polarisation_of(file) in ("", polarisation)]
    if not files:
        wanted = "phase history" if polarisation is None else f"{polarisation} phase history"
        raise InputError(f"{', '.join(map(str, given)) or 'no path'}: no file of {wanted} there")
    twice = {str(file) for file in files if files.count(file) > 1}
    if twice:
        raise InputError(f"{', '.join(sorted(twice))}: given twice, its pulses would count twice")
    for file in files:
        if not file.is_file():
            raise InputError(f"{file}: no such file; give the path of an existing phase history")
        if file.suffix.lower() not in (".mat", ".cphd"):
            raise InputError(f"{file}: suffix '{file.suffix}' is no phase history; give .mat (Gotcha) or .cphd")
    return files


def _polarisation_of(path: Path) -> str:
    last = path.stem.rpartition("_")[2].upper()
    return last if last in POLARISATIONS else ""


def _read_gotcha(path: Path) -> PhaseHistory:
    from scipy.io import loadmat

    try:
        check_mat(path)
        content: Mapping[str, Any] = loadmat(path, variable_names=["data"])
    except InputError:
        raise
    except Exception as error:  # on foreign or broken bytes scipy raises nearly anything
        raise InputError(f"{path}: cannot be read as a MATLAB 5 file ({type(error).__name__})") from error
    data = content.get("data")
    if data is None or data.dtype.names is None or data.size != 1:
        raise InputError(f"{path}: holds no structure 'data'; a phase-history file of the Gotcha data set is needed")
    record = data.reshape(-1)[0]
    missing = [key for key in ("fp", "freq", "x", "y", "z", "r0", "th") if key not in data.dtype.names]
    if missing:
        held = ", ".join(data.dtype.names)
        raise InputError(f"{path}: data lacks the field {', '.join(missing)}; it holds {held}")
    try:
        rows = {key: np.asarray(record[key], np.float64).ravel() for key in ("freq", "x", "y", "z", "r0", "th")}
        samples = np.asarray(record["fp"]).T
        correction = _gotcha_autofocus(record["af"]) if "af" in data.dtype.names else (None, None)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: a field of data is not numeric; Gotcha phase history is needed") from error
    sizes = {key: len(rows[key]) for key in ("x", "y", "z", "r0", "th")}
    if samples.ndim != 2 or samples.shape != (sizes["x"], len(rows["freq"])) or len(set(sizes.values())) > 1:
        listing = ", ".join(f"{key} {size}" for key, size in sizes.items())
        raise InputError(f"{path}: fp {samples.shape[::-1]} does not fit freq {len(rows['freq'])}, {listing}")
    positions = np.column_stack([rows["x"], rows["y"], rows["z"]])
    return PhaseHistory(
        samples,
        rows["freq"],
        positions,
        _unrounded(rows["r0"], positions),
        rows["th"],
        *correction,
        polarisation=_polarisation_of(path),
        name=str(path),
    )


def _unrounded(r0: FloatArray, positions: FloatArray) -> FloatArray:
    """|p| where r0 is nothing but |p| rounded to float32, else r0; see `read_phase_history`."""
    distance = np.linalg.norm(positions, axis=1)
    return distance if (np.abs(r0 - distance) <= np.finfo(np.float32).eps * distance).all() else r0


def _gotcha_autofocus(field: Any) -> tuple[FloatArray | None, FloatArray | None]:
    """(P,) range and phase correction, None where the file holds none."""
    names = field.dtype.names or ()
    if field.size != 1 or not {"r_correct", "ph_correct"} <= set(names):
        return None, None
    record = field.reshape(-1)[0]
    found = (np.asarray(record[key], np.float64).ravel() for key in ("r_correct", "ph_correct"))
    correction, phase = found
    return correction, phase


def _read_cphd(path: Path, polarisation: str | None) -> PhaseHistory:
    """One channel of a CPHD 1.x file in the frequency domain, collected about one fixed reference point."""
    try:
        cphd, wgs84 = import_module("sarkit.cphd"), import_module("sarkit.wgs84")
    except ImportError as error:
        raise PluginUnavailableError(
            f"{path}: CPHD needs sarkit ({error}); install it with: pip install 'featreg[sicd]'"
        ) from error
    try:
        with path.open("rb") as file, cphd.Reader(file) as reader:
            tree = reader.metadata.xmltree
            channel, found = _cphd_channel(path, tree, polarisation)
            signal, pvp = reader.read_channel(channel)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: is no CPHD file or a broken one ({type(error).__name__}: {error})") from error
    if tree.findtext("{*}Global/{*}DomainType") != "FX" or signal.ndim != 2:
        raise InputError(f"{path}: uncompressed samples in the frequency domain (DomainType FX) are needed")
    good = pvp["SIGNAL"] == 1 if "SIGNAL" in pvp.dtype.names else np.ones(len(pvp), np.bool_)
    pvp, signal = pvp[good], signal[good]
    if not len(pvp):
        raise InputError(f"{path}: channel {channel} holds no valid pulse")
    start, step, centre = (np.asarray(pvp[key], np.float64) for key in ("SC0", "SCSS", "SRPPos"))
    top = start + step * (signal.shape[1] - 1)
    if max(np.ptp(start), np.ptp(top)) > UNEVEN * step[0] or np.abs(centre - centre[0]).max() > 1e-3:
        raise InputError(f"{path}: frequencies or reference point change from pulse to pulse, fixed ones are needed")
    samples: NDArray[Any] = signal
    if signal.dtype.names:  # pairs of integers
        real, imaginary = (signal[name].astype(np.float32) for name in signal.dtype.names)
        samples = real + 1j * imaginary
    if "AmpSF" in pvp.dtype.names:
        samples = samples * np.asarray(pvp["AmpSF"], np.float32)[:, None]
    if int(tree.findtext("{*}Global/{*}SGN")) > 0:  # the sign of the phase of a later echo; ours is negative
        samples = samples.conj()
    place = wgs84.cartesian_to_geodetic(centre[0])
    axes = np.stack([wgs84.east(place), wgs84.north(place), wgs84.up(place)])
    antenna = (np.asarray(pvp["TxPos"], np.float64) + np.asarray(pvp["RcvPos"], np.float64)) / 2
    positions = (antenna - centre) @ axes.T
    return PhaseHistory(
        read_only(samples.astype(np.complex64)),
        start[0] + step[0] * np.arange(signal.shape[1]),
        positions,
        np.linalg.norm(positions, axis=1),
        np.rad2deg(np.arctan2(positions[:, 1], positions[:, 0])),
        polarisation=found,
        name=str(path),
    )


def _cphd_channel(path: Path, tree: Any, polarisation: str | None) -> tuple[str, str]:
    """Identifier and polarisation of the one channel asked for."""
    channels = {}
    for node in tree.findall("{*}Channel/{*}Parameters"):
        sent, received = (node.findtext(f"{{*}}Polarization/{{*}}{key}") or "" for key in ("TxPol", "RcvPol"))
        channels[node.findtext("{*}Identifier")] = sent + received if sent + received in POLARISATIONS else ""
    wanted = [key for key, value in channels.items() if polarisation in (None, value)]
    if len(wanted) != 1:
        listing = ", ".join(f"{key} ({value or 'unknown'})" for key, value in channels.items())
        raise InputError(f"{path}: one channel is needed; state the polarisation of one of {listing or 'no channel'}")
    return wanted[0], channels[wanted[0]]
