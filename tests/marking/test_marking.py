"""Marked points: their fit, history and file; and the server that lets nobody else in."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.exports.formats import read_tie_points
from featreg.geometry import Affine, Translation
from featreg.marking.points import MarkedPoints, left_out_errors
from featreg.marking.tiles import TiledScene
from featreg.study.truth import read_truth

TRUTH = Affine(np.array([[1.01, -0.05, 4.0], [0.04, 0.99, 7.0]]))
PLACES = np.array([[10.0, 12.0], [90.0, 15.0], [20.0, 80.0], [85.0, 70.0], [50.0, 40.0]])
SHAPES = ((100, 120), (140, 150))


def marked(path: Path, count: int = 0, **more: Any) -> MarkedPoints:
    points = MarkedPoints(path, ("a.tif", "b.tif"), SHAPES, **more)
    for reference, secondary in zip(PLACES[:count].tolist(), TRUTH(PLACES[:count]).tolist(), strict=True):
        points.add(reference, secondary)
    return points


def predicted(points: MarkedPoints, role: str, xy: list[float]) -> list[float]:
    found = points.predict(role, xy)
    assert found is not None
    return found


def test_a_similarity_predicts_from_two_points_and_an_affine_from_four(tmp_path: Path) -> None:
    points = marked(tmp_path / "p.csv", 1)
    assert points.predict("reference", [50, 40]) is None
    kinds = []
    for count in (2, 3, 4):
        points = marked(tmp_path / f"{count}.csv", count)
        kinds.append(points.state()["model"]["kind"])
        assert np.allclose(predicted(points, "reference", [50, 40]), TRUTH(np.array([[50.0, 40.0]]))[0], atol=5)
    assert kinds == ["similarity", "similarity", "affine"]
    np.testing.assert_allclose(predicted(points, "reference", [50, 40]), TRUTH(np.array([[50.0, 40.0]]))[0], atol=1e-9)
    np.testing.assert_allclose(predicted(points, "secondary", TRUTH(PLACES)[4].tolist()), PLACES[4], atol=1e-9)


def test_a_given_model_predicts_until_points_do(tmp_path: Path) -> None:
    points = marked(tmp_path / "p.csv", initial=Translation(3.0, 4.0))
    assert points.predict("reference", [1, 1]) == [4.0, 5.0]
    assert points.state()["model"] == {"kind": "translation", "given": True}
    points = marked(tmp_path / "q.csv", 4, initial=Translation(3.0, 4.0))
    assert points.state()["model"] == {"kind": "affine", "given": False}


def test_a_wrong_point_stands_out_when_it_is_left_out(tmp_path: Path) -> None:
    points = marked(tmp_path / "p.csv", 5)
    assert max(row["left_out"] for row in points.state()["points"]) < 1e-6
    wrong = TRUTH(PLACES)[4] + (6.0, 8.0)
    points.move(4, "secondary", wrong.tolist())
    rows = points.state()["points"]
    assert rows[4]["left_out"] == pytest.approx(10.0)
    assert rows[4]["residual"] < 9.0


def test_left_out_errors_need_enough_others() -> None:
    four = np.hstack([PLACES[:2], TRUTH(PLACES[:2])])
    assert np.isnan(left_out_errors(four)).all()
    assert left_out_errors(np.zeros((0, 4))).shape == (0,)


def test_every_step_can_be_undone_and_made_again(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    points = marked(path, 3)
    before = points.points.copy()
    points.delete(1)
    np.testing.assert_array_equal(points.points, before[[0, 2]])
    points.undo()
    np.testing.assert_array_equal(points.points, before)
    points.redo()
    assert len(points.points) == len(read_tie_points(path)) == 2
    points.undo()
    points.add([1, 1], [2, 2])
    assert not points.state()["redo"]
    for _ in range(9):
        points.undo()
    assert len(points.points) == len(read_tie_points(path)) == 0


@pytest.mark.parametrize("suffix", [".csv", ".points", ".pts"])
def test_the_file_is_whole_after_every_step_and_taken_up_again(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"p{suffix}"
    points = marked(path)
    for k, (reference, secondary) in enumerate(zip(PLACES.tolist(), TRUTH(PLACES).tolist(), strict=True), start=1):
        points.add(reference, secondary)
        found = read_tie_points(path)
        np.testing.assert_allclose(found.reference_xy, PLACES[:k], atol=1e-6)
        np.testing.assert_allclose(found.secondary_xy, TRUTH(PLACES[:k]), atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    np.testing.assert_allclose(marked(path).points, points.points, atol=1e-6)
    np.testing.assert_allclose(read_truth(path)(PLACES), TRUTH(PLACES), atol=1e-5)


def test_what_cannot_be_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"kept as \.csv, \.points, \.pts"):
        marked(tmp_path / "p.txt")
    with pytest.raises(InputError, match="does not exist"):
        marked(tmp_path / "missing" / "p.csv")
    points = marked(tmp_path / "p.csv", 2)
    for wrong in ([1], "ab", [1, None], [True, 2], [float("nan"), 1], None):
        with pytest.raises(ParameterError, match="a point is two"):
            points.add(wrong, [1, 1])
    with pytest.raises(InputError, match="outside the secondary of 150 x 140"):
        points.add([1, 1], [150, 1])
    for index in (2, -1, True, "0", 0.0):
        with pytest.raises(ParameterError, match="there is no point"):
            points.delete(index)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="role must be"):
        points.move(0, "third", [1, 1])
    assert len(points.points) == 2


def test_a_step_that_cannot_be_saved_is_not_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = marked(tmp_path / "p.csv", 2)

    def full(source: Any, target: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match="No space left"):
        points.add([1, 1], [2, 2])
    assert len(points.points) == len(read_tie_points(tmp_path / "p.csv")) == 2
    assert len(list(tmp_path.iterdir())) == 1


def test_tiles_show_the_scene_where_it_is(tmp_path: Path) -> None:
    """A bright square keeps its place at every level, and all tiles are toned alike."""
    pixels = np.random.default_rng(0).gamma(4, 0.25, (700, 900)).astype(np.float32)
    pixels[512:640, 256:384] = 40
    np.save(tmp_path / "a.npy", pixels)
    scene = TiledScene(str(tmp_path / "a.npy"))

    def shown(level: int, column: int, row: int) -> Any:
        return cv2.imdecode(np.frombuffer(scene.tile(level, column, row), np.uint8), cv2.IMREAD_GRAYSCALE)

    assert shown(0, 1, 2).shape == (256, 256)
    assert shown(0, 1, 2)[4:124, 4:124].min() > 240
    assert shown(0, 1, 2)[140:, 140:].mean() < 200
    assert shown(1, 0, 1)[4:60, 132:188].min() > 240
    assert shown(2, 0, 0)[130:158, 66:94].min() > 230
    for wrong in ((0, 4, 0), (0, 0, -1), (-1, 0, 0), (50, 0, 0)):
        with pytest.raises(ParameterError, match="there is no tile"):
            scene.tile(*wrong)


def test_coarse_tiles_of_a_large_scene_come_from_its_overview(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("featreg.marking.tiles.OVERVIEW", 200)
    pixels = np.random.default_rng(0).gamma(4, 0.25, (700, 900)).astype(np.float32)
    pixels[:350] = 30
    scene = TiledScene(pixels)
    assert scene.factor == 8
    made: Any = cv2.imdecode(np.frombuffer(scene.tile(3, 0, 0), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert made[2:40, 2:110].min() > 240
    assert made[48:85, 2:110].mean() < 200


PORT = 8765
HERE = f"http://127.0.0.1:{PORT}"


@pytest.fixture
def client(tmp_path: Path) -> Any:
    testclient = pytest.importorskip("starlette.testclient", reason="the marking page needs: pip install featreg[web]")
    from featreg.marking.server import marking_app

    rng = np.random.default_rng(0)
    scenes = tuple(TiledScene(rng.gamma(4, 0.25, shape).astype(np.float32)) for shape in SHAPES)
    app = marking_app(marked(tmp_path / "p.csv"), scenes, "secret-token", PORT)  # type: ignore[arg-type]
    return testclient.TestClient(app, base_url=HERE)


def test_the_server_answers_with_the_token(client: Any, tmp_path: Path) -> None:
    page = client.get("/secret-token/")
    assert page.status_code == 200
    assert "default-src 'none'" in page.headers["content-security-policy"]
    assert "access-control-allow-origin" not in page.headers
    assert client.get("/secret-token/mark.js").headers["content-type"].startswith("text/javascript")
    assert client.get("/secret-token/tile/secondary/0/0/0").headers["content-type"] == "image/webp"
    said = client.post("/secret-token/act", json={"action": "add", "reference": [1, 2], "secondary": [3, 4]})
    assert said.json()["points"][0]["secondary"] == [3.0, 4.0]
    assert len(read_tie_points(tmp_path / "p.csv")) == 1


@pytest.mark.parametrize("path", ["/", "/secret-toke/", "/secret-tokens/state", "/state", "/SECRET-TOKEN/", "/é/"])
def test_without_the_token_nothing_is_told(client: Any, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 403
    assert "secret" not in answer.text


@pytest.mark.parametrize(
    "headers",
    [
        {"host": f"evil.example:{PORT}"},
        {"host": "127.0.0.1"},
        {"host": f"127.0.0.1:{PORT + 1}"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
    ],
)
def test_other_hosts_and_other_sites_are_refused(client: Any, headers: dict[str, str]) -> None:
    assert client.get("/secret-token/state", headers=headers).status_code == 403
    assert client.get("/secret-token/state", headers={"origin": HERE}).status_code == 200


def filled(path: str) -> str:
    """A route's path with something in every place of it."""
    return (
        path.replace("{role}", "reference")
        .replace("{level:int}", "0")
        .replace("{column:int}", "0")
        .replace("{row:int}", "0")
    )


def test_every_route_needs_the_token_and_this_very_host(client: Any) -> None:
    routes = [(filled(route.path), method) for route in client.app.app.routes for method in sorted(route.methods)]
    assert len({path for path, _ in routes}) == 6
    json_kind = {"content-type": "application/json"}
    for path, method in routes:
        assert path.startswith("/secret-token/")
        body: dict[str, Any] = {"content": '{"action": "undo"}', "headers": json_kind} if method == "POST" else {}
        assert client.request(method, path, **body).status_code == 200, (method, path)
        other = path.replace("secret-token", "secret-tokem")
        for wrong in (other, path.removeprefix("/secret-token"), f"/x{path}", f"/{path}", f"{other}?secret-token"):
            assert client.request(method, wrong, **body).status_code == 403, (method, wrong)
        for host in (
            "evil.example",
            f"evil.example:{PORT}",
            "127.0.0.1",
            f"127.0.0.1.evil.example:{PORT}",
            "",
            f"[::1]:{PORT}",
        ):
            headers = {**body.get("headers", {}), "host": host}
            refused = client.request(method, path, content=body.get("content"), headers=headers)
            assert refused.status_code == 403, (method, path, host)
            assert "secret" not in refused.text


@pytest.mark.parametrize(
    ("path", "hosts"),
    [
        ("/secret-token/state", []),
        ("/secret-token/state", [f"127.0.0.1:{PORT}", "evil.example"]),
        ("/secret-token/state", ["evil.example", f"127.0.0.1:{PORT}"]),
        ("*", [f"127.0.0.1:{PORT}"]),
        ("", [f"127.0.0.1:{PORT}"]),
        ("/\udcff/", [f"127.0.0.1:{PORT}"]),
    ],
)
def test_requests_that_no_browser_sends_are_refused_too(client: Any, path: str, hosts: list[str]) -> None:
    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    headers = [(b"host", host.encode()) for host in hosts]
    scope = {"type": "http", "method": "GET", "path": path, "headers": headers, "query_string": b""}
    asyncio.run(client.app(scope, receive, send))
    assert sent[0]["status"] == 403


def test_no_socket_is_opened(client: Any) -> None:
    disconnect = pytest.importorskip("starlette.websockets").WebSocketDisconnect
    with pytest.raises(disconnect), client.websocket_connect("/secret-token/state"):
        pass


def test_a_form_of_another_site_cannot_act(client: Any) -> None:
    """A form needs no permission to be sent elsewhere, but cannot name JSON as its kind."""
    sent = client.post("/secret-token/act", content='{"action": "undo"}', headers={"content-type": "text/plain"})
    assert sent.status_code == 403


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('{"action": "format"}', "action must be one of"),
        ('{"action": ["add"]}', "action must be one of"),
        ('{"action": "add", "reference": [1, 1]}', "add takes reference, secondary, got reference"),
        ('{"action": "add", "reference": [1, 1], "secondary": [1e999, 1]}', "finite"),
        ("[1]", "one JSON object, got list"),
        ("{", "one JSON object"),
        (" " * 5000, "at most 4096 bytes"),
    ],
)
def test_nonsense_gets_a_reason(client: Any, body: str, message: str) -> None:
    answer = client.post("/secret-token/act", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 400
    assert message in answer.json()["error"]
    assert client.get("/secret-token/state").json()["points"] == []


def test_files_beside_the_page_cannot_be_had(client: Any) -> None:
    for path in ("points.py", "../truth.py", "%2e%2e/truth.py", "tile/reference/0/9/0", "tile/third/0/0/0"):
        assert client.get(f"/secret-token/{path}").status_code in (400, 403, 404)


def test_a_taken_port_is_one_clear_error(tmp_path: Path) -> None:
    pytest.importorskip("starlette")
    import socket

    from featreg.marking.server import serve

    scene = TiledScene(np.random.default_rng(0).random((64, 64), np.float32))
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(InputError, match=r"cannot listen on 127\.0\.0\.1"):
            serve(marked(tmp_path / "p.csv"), (scene, scene), port=other.getsockname()[1])
