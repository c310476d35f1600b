"""The server of the marking page lets nobody else in."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.exports.formats import read_tie_points
from featreg.marking.tiles import TiledScene
from made.marked_points import SHAPES, marked

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
    # In a thread of its own: tests of browsers may have left a loop that runs in this one.
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, client.app(scope, receive, send)).result()
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
