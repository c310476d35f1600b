"""Phase histories: what the type refuses, selection around the circle, and the readers."""

from __future__ import annotations

import pickle
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.focusing.phase_history import PhaseHistory
from featreg.focusing.phase_history_files import read_phase_history

FREQUENCIES = np.linspace(9.3e9, 9.9e9, 8)


def history(azimuth_deg: Any, **other: Any) -> PhaseHistory:
    """One pulse per azimuth on a circle; every sample holds the number of its pulse."""
    azimuth = np.asarray(azimuth_deg, np.float64)
    turn = np.deg2rad(azimuth)
    positions = np.column_stack([700 * np.cos(turn), 700 * np.sin(turn), np.full(len(turn), 500.0)])
    samples = np.repeat(np.arange(len(turn), dtype=np.complex64)[:, None], len(FREQUENCIES), axis=1)
    made = {
        "samples": samples,
        "frequencies": FREQUENCIES,
        "positions": positions,
        "r0": np.linalg.norm(positions, axis=1),
        "azimuth_deg": azimuth,
    }
    return PhaseHistory(**{**made, **other})


def write_gotcha(path: Path, azimuth_deg: Any, *, leave_out: tuple[str, ...] = (), **other: Any) -> PhaseHistory:
    """A MATLAB file in the layout of the data set, in float32 as there, and what it should be read as."""
    from scipy.io import savemat

    h = history(azimuth_deg)
    x, y, z = h.positions.astype(np.float32).T[:, None]
    data: dict[str, Any] = {
        "fp": h.samples.T,
        "freq": h.frequencies.astype(np.float32)[:, None],
        "x": x,
        "y": y,
        "z": z,
        "r0": h.r0.astype(np.float32)[None],
        "th": h.azimuth_deg.astype(np.float32)[None],
        "phi": np.full((1, len(h)), 35.0, np.float32),
        **other,
    }
    savemat(path, {"data": {key: value for key, value in data.items() if key not in leave_out}})
    return h


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"samples": np.zeros((3, 8))}, "samples must be complex"),
        ({"samples": np.zeros(8, np.complex64)}, "samples must be complex"),
        ({"samples": np.zeros((0, 8), np.complex64)}, "samples must be complex"),
        ({"samples": np.full((3, 8), np.nan, np.complex64)}, "samples must be finite"),
        ({"frequencies": FREQUENCIES[:7]}, "frequencies must have shape"),
        ({"frequencies": FREQUENCIES[::-1]}, "ascending and evenly spaced"),
        ({"frequencies": FREQUENCIES**2}, "ascending and evenly spaced"),
        ({"frequencies": FREQUENCIES - 9.5e9}, "ascending and evenly spaced"),
        ({"positions": np.zeros((2, 3))}, "positions must be finite"),
        ({"positions": np.full((3, 3), np.inf)}, "positions must be finite"),
        ({"r0": np.ones(4)}, "r0 must have shape"),
        ({"r0": np.array([1.0, np.nan, 1.0])}, "r0 must be finite"),
        ({"autofocus_phase": np.zeros(2)}, "autofocus_phase must have shape"),
    ],
)
def test_what_does_not_fit_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        history([0.0, 1.0, 2.0], **wrong)


def test_arrays_are_locked_and_the_callers_stay_free() -> None:
    samples = np.ones((2, 8), np.complex64)
    h = history([0, 1], samples=samples)
    samples[0] = 7
    for values in (h.samples, h.frequencies, h.positions, h.r0, h.azimuth_deg):
        assert not values.flags.writeable
    assert np.array_equal(pickle.loads(pickle.dumps(h)).samples, h.samples)


@pytest.mark.parametrize(
    ("start", "stop", "expected"),
    [
        (0.0, 2.0, [0, 1]),
        (1.0, 1.5, [1]),
        (358.0, 2.0, [358, 359, 0, 1]),
        (-2.0, 2.0, [358, 359, 0, 1]),
        (718.0, 722.0, [358, 359, 0, 1]),
    ],
)
def test_a_sector_is_half_open_and_goes_on_where_the_circle_closes(
    start: float, stop: float, expected: list[int]
) -> None:
    chosen = history(np.arange(360.0)).select(start, stop)
    assert chosen.azimuth_deg.tolist() == expected
    assert chosen.samples[:, 0].real.tolist() == expected


def test_the_whole_circle_starts_where_it_is_asked_to() -> None:
    chosen = history(np.arange(360.0)).select(90, 450)
    assert len(chosen) == 360
    assert chosen.azimuth_deg[[0, -1]].tolist() == [90, 89]


def test_azimuths_stay_below_360() -> None:
    assert history([-1e-14, 360.0, -90.0]).azimuth_deg.tolist() == [0, 0, 270]


def test_an_empty_sector_says_what_there_is() -> None:
    with pytest.raises(InputError, match=r"no pulse between azimuth 5 and 6 .* 3 from 0.000 to 2.000"):
        history([0, 1, 2]).select(5, 6)
    with pytest.raises(ParameterError, match="two numbers"):
        history([0, 1, 2]).select(np.nan, 6)


def test_the_middle_of_an_aperture_that_crosses_zero() -> None:
    h = history([358.0, 359.0, 0.0, 1.0, 2.0])
    np.testing.assert_allclose(h.relative_azimuth_deg, [-2, -1, 0, 1, 2], atol=1e-9)
    assert h.central_pulse == 2


def test_parts_make_the_whole_again() -> None:
    h = history(np.arange(6.0), autofocus_phase=np.arange(6.0))
    whole = PhaseHistory.concatenate([h.select(0, 2), h.select(2, 6)])
    for key in ("samples", "positions", "r0", "azimuth_deg", "autofocus_phase"):
        np.testing.assert_array_equal(getattr(whole, key), getattr(h, key))
    assert whole.autofocus_range is None


def test_what_does_not_belong_together_is_not_joined() -> None:
    h = history([0, 1])
    with pytest.raises(InputError, match="other frequencies"):
        PhaseHistory.concatenate([h, replace(h, frequencies=FREQUENCIES + 2e6)])
    with pytest.raises(InputError, match="state one polarisation"):
        PhaseHistory.concatenate([replace(h, polarisation="HH"), replace(h, polarisation="VV")])
    with pytest.raises(InputError, match="nothing to concatenate"):
        PhaseHistory.concatenate([])


def test_a_known_correction_is_applied_once() -> None:
    h = history([0, 1], autofocus_range=np.array([0.1, 0.2]), autofocus_phase=np.array([0.0, np.pi / 2]))
    done = h.corrected()
    np.testing.assert_allclose(done.r0, h.r0 + np.array([0.1, 0.2]))
    np.testing.assert_allclose(done.samples[1], 1j * h.samples[1], atol=1e-6)
    assert done.corrected() is done


def test_a_gotcha_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "data_3dsar_pass1_az001_HV.mat"
    correction = {"r_correct": np.full((1, 4), 0.25, np.float32), "ph_correct": np.ones((1, 4), np.float32)}
    h = write_gotcha(path, [0.0, 0.25, 0.5, 0.75], af=correction)
    read = read_phase_history(path)
    np.testing.assert_array_equal(read.samples, h.samples)
    np.testing.assert_allclose(read.frequencies, h.frequencies, atol=600)
    np.testing.assert_allclose(read.positions, h.positions, atol=1e-4)
    np.testing.assert_allclose(read.azimuth_deg, h.azimuth_deg, atol=1e-6)
    assert read.polarisation == "HV"
    assert read.autofocus_range is not None
    assert read.autofocus_phase is not None
    assert read.autofocus_range.tolist() == [0.25] * 4
    assert read.autofocus_phase.tolist() == [1.0] * 4


def test_ranges_rounded_to_float32_are_computed_afresh_and_others_kept(tmp_path: Path) -> None:
    write_gotcha(tmp_path / "a.mat", np.linspace(0, 1, 50))
    read = read_phase_history(tmp_path / "a.mat")
    np.testing.assert_array_equal(read.r0, np.linalg.norm(read.positions, axis=1))
    off = (np.linalg.norm(history([0.0, 1.0]).positions, axis=1) + 0.01).astype(np.float32)
    write_gotcha(tmp_path / "b.mat", [0.0, 1.0], r0=off[None])
    np.testing.assert_array_equal(read_phase_history(tmp_path / "b.mat").r0, off)


def test_several_files_one_polarisation_any_sector(tmp_path: Path) -> None:
    for i in range(3):
        for pol in ("HH", "VV"):
            write_gotcha(tmp_path / f"data_3dsar_pass1_az{i + 1:03d}_{pol}.mat", i + np.array([0.1, 0.4, 0.7]))
    read = read_phase_history(tmp_path, polarisation="VV", azimuth=(0.3, 2.2))
    np.testing.assert_allclose(read.azimuth_deg, [0.4, 0.7, 1.1, 1.4, 1.7, 2.1], atol=1e-6)
    assert read.polarisation == "VV"
    with pytest.raises(InputError, match="state one polarisation"):
        read_phase_history(tmp_path)
    with pytest.raises(InputError, match="no file of HV"):
        read_phase_history(tmp_path, polarisation="HV")
    with pytest.raises(InputError, match="none of 3 files"):
        read_phase_history(tmp_path, polarisation="HH", azimuth=(10, 20))
    with pytest.raises(ParameterError, match="polarisation must be one of"):
        read_phase_history(tmp_path, polarisation="hh")


def test_a_file_that_ends_too_soon_and_one_given_twice_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "whole.mat"
    write_gotcha(path, np.linspace(0, 1, 40))
    content = path.read_bytes()
    for size in (0, 50, 128, 300, len(content) // 2, len(content) - 9):
        (tmp_path / "part.mat").write_bytes(content[:size])
        with pytest.raises(InputError, match=r"part\.mat"):
            read_phase_history(tmp_path / "part.mat")
    with pytest.raises(InputError, match="given twice"):
        read_phase_history([path, path])


def test_what_is_no_path_and_no_sector_is_refused(tmp_path: Path) -> None:
    write_gotcha(tmp_path / "a.mat", [0.0, 1.0])
    for wrong in (None, 5, [tmp_path / "a.mat", None]):
        with pytest.raises(InputError, match="paths of phase-history files"):
            read_phase_history(wrong)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="two numbers"):
        read_phase_history(tmp_path / "a.mat", azimuth=3)  # type: ignore[arg-type]


def test_a_file_that_is_something_else_is_named(tmp_path: Path) -> None:
    from scipy.io import savemat

    with pytest.raises(InputError, match="no such file"):
        read_phase_history(tmp_path / "missing.mat")
    with pytest.raises(InputError, match="no file of phase history"):
        read_phase_history([])
    (tmp_path / "image.png").write_bytes(b"\x89PNG")
    with pytest.raises(InputError, match=r"suffix '.png'"):
        read_phase_history(tmp_path / "image.png")
    (tmp_path / "noise.mat").write_bytes(bytes(range(200)))
    with pytest.raises(InputError, match="cannot be read as a MATLAB 5 file"):
        read_phase_history(tmp_path / "noise.mat")
    savemat(tmp_path / "other.mat", {"image": np.eye(4)})
    with pytest.raises(InputError, match="no structure 'data'"):
        read_phase_history(tmp_path / "other.mat")
    savemat(tmp_path / "plain.mat", {"data": np.eye(4)})
    with pytest.raises(InputError, match="no structure 'data'"):
        read_phase_history(tmp_path / "plain.mat")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"leave_out": ("r0", "th")}, "lacks the field r0, th; it holds fp, freq"),
        ({"z": np.ones((1, 3))}, "does not fit freq 8, x 2, y 2, z 3"),
        ({"fp": np.ones((7, 2), np.complex64)}, r"fp \(7, 2\) does not fit freq 8"),
        ({"fp": np.ones((8, 2))}, "samples must be complex"),
        ({"x": np.array([["a", "b"]], object)}, "not numeric"),
    ],
)
def test_a_gotcha_file_with_wrong_fields(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    write_gotcha(tmp_path / "wrong.mat", [0.0, 1.0], **changes)
    with pytest.raises(InputError, match=message):
        read_phase_history(tmp_path / "wrong.mat")


def test_cphd_without_its_library_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sarkit", None)
    monkeypatch.setitem(sys.modules, "sarkit.cphd", None)
    (tmp_path / "a.cphd").write_bytes(b"CPHD/1.1.0\n")
    with pytest.raises(PluginUnavailableError, match=r"featreg\[sicd\]"):
        read_phase_history(tmp_path / "a.cphd")


CPHD = """<CPHD xmlns="http://api.nsgreg.nga.mil/schema/cphd/1.1.0">
<Global><DomainType>{domain}</DomainType><SGN>{sgn}</SGN></Global>
<Channel><Parameters><Identifier>1</Identifier>
<Polarization><TxPol>V</TxPol><RcvPol>H</RcvPol></Polarization></Parameters></Channel>
<Data><SignalArrayFormat>CI4</SignalArrayFormat><NumBytesPVP>120</NumBytesPVP><NumCPHDChannels>1</NumCPHDChannels>
<Channel><Identifier>1</Identifier><NumVectors>3</NumVectors><NumSamples>8</NumSamples>
<SignalArrayByteOffset>0</SignalArrayByteOffset><PVPArrayByteOffset>0</PVPArrayByteOffset></Channel>
<NumSupportArrays>0</NumSupportArrays></Data>
<CollectionID><Classification>U</Classification><ReleaseInfo>U</ReleaseInfo></CollectionID>
<PVP>{fields}</PVP></CPHD>"""
FIELDS = {"TxPos": 3, "RcvPos": 3, "SRPPos": 3, "AmpSF": 1, "SC0": 1, "SCSS": 1, "SIGNAL": 1}


def write_cphd(path: Path, *, sgn: int = -1, domain: str = "FX", drift: float = 0.0) -> np.ndarray[Any, Any]:
    """Three pulses from 1 km to the east, north and west of a place, 800 m above; the last one is marked as bad."""
    cphd, wgs84 = pytest.importorskip("sarkit.cphd"), pytest.importorskip("sarkit.wgs84")
    etree = pytest.importorskip("lxml.etree")
    fields, offset = "", 0
    for key, size in FIELDS.items():
        form = "I8" if key == "SIGNAL" else "X=F8;Y=F8;Z=F8;" if size == 3 else "F8"
        fields += f"<{key}><Offset>{offset}</Offset><Size>{size}</Size><Format>{form}</Format></{key}>"
        offset += size
    tree = etree.ElementTree(etree.fromstring(CPHD.format(domain=domain, sgn=sgn, fields=fields)))
    place = np.array([48.0, 11.0, 500.0])
    centre = wgs84.geodetic_to_cartesian(place)
    axes = np.stack([wgs84.east(place), wgs84.north(place), wgs84.up(place)])
    local = np.array([[1000.0, 0, 800], [0, 1000, 800], [-1000, 0, 800]])
    pvp = np.zeros(3, cphd.get_pvp_dtype(tree))
    apart = np.array([0.0, 0.0, 5.0])
    pvp["TxPos"], pvp["RcvPos"] = centre + (local + apart) @ axes, centre + (local - apart) @ axes
    pvp["SRPPos"], pvp["AmpSF"], pvp["SC0"], pvp["SCSS"] = centre, 0.5, 9e9, 1e6
    pvp["SC0"] += drift * np.arange(3)
    pvp["SIGNAL"] = [1, 1, 0]
    numbers = np.arange(24).reshape(3, 8)
    signal = np.zeros((3, 8), cphd.binary_format_string_to_dtype("CI4"))
    signal["real"], signal["imag"] = numbers, -2 * numbers
    with path.open("wb") as file, cphd.Writer(file, cphd.Metadata(xmltree=tree)) as writer:
        writer.write_signal("1", signal)
        writer.write_pvp("1", pvp)
    return numbers


@pytest.mark.parametrize("sgn", [-1, 1])
def test_a_cphd_file_stands_east_north_up_of_its_reference_point(tmp_path: Path, sgn: int) -> None:
    numbers = write_cphd(tmp_path / "a.cphd", sgn=sgn)
    read = read_phase_history(tmp_path / "a.cphd", polarisation="VH")
    np.testing.assert_allclose(read.positions, [[1000, 0, 800], [0, 1000, 800]], atol=1e-5)
    np.testing.assert_allclose(read.r0, np.hypot(1000, 800), atol=1e-5)
    np.testing.assert_allclose(read.relative_azimuth_deg, [-45, 45], atol=1e-6)
    np.testing.assert_allclose(read.frequencies, 9e9 + 1e6 * np.arange(8))
    np.testing.assert_array_equal(read.samples, numbers[:2] * (0.5 + 1j * sgn))


@pytest.mark.parametrize(
    ("written", "asked", "message"),
    [
        ({"domain": "TOA"}, {}, "frequency domain"),
        ({"drift": 1e5}, {}, "change from pulse to pulse"),
        ({}, {"polarisation": "HH"}, r"one channel is needed.* 1 \(VH\)"),
    ],
)
def test_cphd_files_of_other_kinds_are_refused(
    tmp_path: Path, written: dict[str, Any], asked: dict[str, Any], message: str
) -> None:
    write_cphd(tmp_path / "a.cphd", **written)
    with pytest.raises(InputError, match=message):
        read_phase_history(tmp_path / "a.cphd", **asked)


def test_broken_cphd(tmp_path: Path) -> None:
    pytest.importorskip("sarkit.cphd")
    (tmp_path / "a.cphd").write_bytes(b"CPHD/1.1.0\nnothing else")
    with pytest.raises(InputError, match="no CPHD file or a broken one"):
        read_phase_history(tmp_path / "a.cphd")


@pytest.mark.realdata
def test_the_real_files(realdata: Path) -> None:
    h = read_phase_history(realdata / "gotcha", polarisation="HH")
    assert h.samples.shape == (352, 424)
    assert 0 < h.azimuth_deg[0] < 0.01
    assert 2.99 < h.azimuth_deg[-1] < 3.0
    np.testing.assert_allclose(h.azimuth_deg, np.rad2deg(np.arctan2(h.positions[:, 1], h.positions[:, 0])), atol=1e-4)
    assert (np.diff(h.azimuth_deg) > 0).all()
    assert len(read_phase_history(realdata / "gotcha", azimuth=(0.5, 2.5))) == 234
