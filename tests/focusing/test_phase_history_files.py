"""Phase histories from files of the Gotcha data set and CPHD."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.focusing.phase_history import PhaseHistory
from featreg.focusing.phase_history_files import read_phase_history

History = Callable[..., PhaseHistory]
Write = Callable[..., PhaseHistory]


@pytest.fixture
def write_gotcha(history: History) -> Write:
    """A MATLAB file in the layout of the data set, in float32 as there, and what it should be read as."""

    def write(path: Path, azimuth_deg: Any, *, leave_out: tuple[str, ...] = (), **other: Any) -> PhaseHistory:
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

    return write


def test_a_gotcha_file_is_read_as_it_was_written(write_gotcha: Write, tmp_path: Path) -> None:
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


def test_ranges_rounded_to_float32_are_computed_afresh_and_others_kept(
    history: History, write_gotcha: Write, tmp_path: Path
) -> None:
    write_gotcha(tmp_path / "a.mat", np.linspace(0, 1, 50))
    read = read_phase_history(tmp_path / "a.mat")
    np.testing.assert_array_equal(read.r0, np.linalg.norm(read.positions, axis=1))
    off = (np.linalg.norm(history([0.0, 1.0]).positions, axis=1) + 0.01).astype(np.float32)
    write_gotcha(tmp_path / "b.mat", [0.0, 1.0], r0=off[None])
    np.testing.assert_array_equal(read_phase_history(tmp_path / "b.mat").r0, off)


def test_several_files_one_polarisation_any_sector(write_gotcha: Write, tmp_path: Path) -> None:
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


def test_a_file_that_ends_too_soon_and_one_given_twice_are_refused(write_gotcha: Write, tmp_path: Path) -> None:
    path = tmp_path / "whole.mat"
    write_gotcha(path, np.linspace(0, 1, 40))
    content = path.read_bytes()
    for size in (0, 50, 128, 300, len(content) // 2, len(content) - 9):
        (tmp_path / "part.mat").write_bytes(content[:size])
        with pytest.raises(InputError, match=r"part\.mat"):
            read_phase_history(tmp_path / "part.mat")
    with pytest.raises(InputError, match="given twice"):
        read_phase_history([path, path])


def test_what_is_no_path_and_no_sector_is_refused(write_gotcha: Write, tmp_path: Path) -> None:
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
def test_a_gotcha_file_with_wrong_fields(
    write_gotcha: Write, tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
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
