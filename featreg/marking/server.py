"""The local server of the marking page: loopback only, every request with the token, nothing for other sites."""

from __future__ import annotations

import hmac
import json
import secrets
import socket
from collections.abc import Awaitable, Callable
from importlib.resources import files
from typing import Any

from featreg.errors import FeatregError, InputError, ParameterError
from featreg.marking.points import ROLES, MarkedPoints
from featreg.marking.tiles import TILE, TiledScene

HOST = "127.0.0.1"
#: Most bytes of a request's body; a point needs a hundred.
LARGEST = 4096
PARTS = {
    "": ("mark.html", "text/html"),
    "mark.css": ("mark.css", "text/css"),
    "mark.js": ("mark.js", "text/javascript"),
}
HEADERS = (
    (b"content-security-policy", b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
     b"connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)  # fmt: skip

Message = dict[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]


def marking_app(points: MarkedPoints, scenes: tuple[TiledScene, TiledScene], token: str, port: int) -> Any:
    """Return the ASGI application.

    Parameters
    ----------
    points : what is marked
    scenes : reference and secondary
    token : first part of every address
    port : on which it is served; a request whose Host header names another place is refused (DNS rebinding)

    Raises
    ------
    InputError
        Starlette is not installed.
    """
    require_web()
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.requests import Request
    from starlette.responses import JSONResponse, Response
    from starlette.routing import Route

    def state(request: Request) -> Response:
        return JSONResponse(points.state() | {"tile": TILE})

    def tile(request: Request) -> Response:
        where = request.path_params
        scene = scenes[_side(where["role"])]
        webp = scene.tile(where["level"], where["column"], where["row"])
        return Response(webp, media_type="image/webp", headers={"cache-control": "private, max-age=3600"})

    async def act(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(answer, points, await _body(request.stream())))

    def part(name: str, kind: str) -> Callable[[Request], Response]:
        text = files("featreg.marking").joinpath(name).read_text(encoding="utf-8")
        return lambda request: Response(text, media_type=kind)

    def misuse(request: Request, error: Exception) -> Response:
        return JSONResponse({"error": str(error)}, status_code=400)

    routes = [
        Route(f"/{token}/state", state),
        Route(f"/{token}/act", act, methods=["POST"]),
        Route(f"/{token}/tile/{{role}}/{{level:int}}/{{column:int}}/{{row:int}}", tile),
        *(Route(f"/{token}/{path}", part(name, kind)) for path, (name, kind) in PARTS.items()),
    ]
    return Guard(Starlette(routes=routes, exception_handlers={FeatregError: misuse}), token, port)


def answer(points: MarkedPoints, given: dict[str, Any]) -> dict[str, Any]:
    """Carry out what the page asks for: {"action": name, ...}, and return the new state, or the predicted place.

    Raises
    ------
    ParameterError, InputError
        An action that is not known, lacks something, or cannot be done.
    """
    actions: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
        "add": (points.add, ("reference", "secondary")),
        "move": (points.move, ("index", "role", "xy")),
        "delete": (points.delete, ("index",)),
        "undo": (points.undo, ()),
        "redo": (points.redo, ()),
        "predict": (points.predict, ("role", "xy")),
    }
    name = given.get("action")
    if not isinstance(name, str) or name not in actions:
        raise ParameterError(f"action must be one of {', '.join(actions)}, got {name!r}")
    call, wanted = actions[name]
    values = {key: value for key, value in given.items() if key != "action"}
    if set(values) != set(wanted):
        raise ParameterError(f"{name} takes {', '.join(wanted) or 'nothing'}, got {', '.join(values) or 'nothing'}")
    with points.lock:
        made = call(**values)
        return {"xy": made} if name == "predict" else points.state() | {"tile": TILE}


class Guard:
    """Lets a request through only with the token, to this very host, and from no other site.

    The token is compared in constant time. A page of another site can send requests to the loopback, by a name of its
    own that resolves there too; it knows neither the token nor can it choose Host or Origin.
    """

    def __init__(self, app: Any, token: str, port: int) -> None:
        self.app, self.token = app, token.encode()
        self.hosts = {f"{HOST}:{port}".encode(), f"localhost:{port}".encode()}

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            await send({"type": "websocket.close", "code": 1008})
            return
        headers = dict(scope["headers"])
        said = scope["path"].removeprefix("/").partition("/")[0].encode(errors="replace")
        known = hmac.compare_digest(said, self.token)
        # Two Host headers would leave it open which of them whoever comes before this server went by.
        named = [value for name, value in scope["headers"] if name == b"host"]
        here = len(named) == 1 and named[0] in self.hosts
        origin = headers.get(b"origin")
        same = origin is None or origin in {b"http://" + host for host in self.hosts}
        json_only = scope["method"] in ("GET", "HEAD") or headers.get(b"content-type") == b"application/json"
        if not (known and here and same and json_only):
            plain = (b"content-type", b"text/plain; charset=utf-8")
            await send({"type": "http.response.start", "status": 403, "headers": [plain, *HEADERS]})
            await send({"type": "http.response.body", "body": b"refused: open the address that featreg mark printed\n"})
            return

        async def answered(message: Message) -> None:
            if message["type"] == "http.response.start":
                names = {name for name, _ in message["headers"]}
                more = [] if b"cache-control" in names else [(b"cache-control", b"no-store")]
                message = {**message, "headers": [*message["headers"], *HEADERS, *more]}
            await send(message)

        await self.app(scope, receive, answered)


def serve(
    points: MarkedPoints,
    scenes: tuple[TiledScene, TiledScene],
    *,
    port: int = 0,
    started: Callable[[str], None] | None = None,
) -> None:
    """Serve the marking page on 127.0.0.1 until interrupted.

    Parameters
    ----------
    points, scenes : see `marking_app`
    port : to listen on; 0 takes a free one
    started : called with the address of the page once it can be opened

    Raises
    ------
    InputError
        The port is taken, or Starlette or uvicorn are not installed.
    """
    require_web()
    import uvicorn

    listener = socket.socket()
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise InputError(f"cannot listen on {HOST}:{port}: {error}; give another port, or 0 for a free one") from error
    with listener:
        port = int(listener.getsockname()[1])
        token = secrets.token_urlsafe(24)
        app = marking_app(points, scenes, token, port)
        config = uvicorn.Config(app, log_level="critical", access_log=False, lifespan="off", server_header=False)
        listener.listen()
        if started is not None:
            started(f"http://{HOST}:{port}/{token}/")
        uvicorn.Server(config).run(sockets=[listener])


def require_web() -> None:
    """Raise an `InputError` that names the extra where the web framework is missing."""
    try:
        import starlette
        import uvicorn  # noqa: F401
    except ImportError as error:
        raise InputError(f"the marking page needs {error.name}: pip install 'featreg[web]'") from error
    del starlette


def _side(role: str) -> int:
    if role not in ROLES:
        raise ParameterError(f"role must be 'reference' or 'secondary', got {role!r}")
    return ROLES.index(role)


async def _body(stream: Any) -> dict[str, Any]:
    content = b""
    async for chunk in stream:
        content += chunk
        if len(content) > LARGEST:
            raise ParameterError(f"a request has at most {LARGEST} bytes")
    try:
        given = json.loads(content)
    except ValueError as error:
        raise ParameterError(f"a request is one JSON object: {error}") from error
    if not isinstance(given, dict):
        raise ParameterError(f"a request is one JSON object, got {type(given).__name__}")
    return given
