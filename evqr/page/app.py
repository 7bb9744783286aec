"""The page as a web application: it tells, and who has the token may change the job."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from evqr.errors import EvqrError
from evqr.extras import needs_extra
from evqr.page.metrics import LineCollector
from evqr.page.state import LineState

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

COOKIE = "evqr_token"

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self';"
        " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

STATIC = {
    "page.css": "text/css",
    "page.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}

OPEN_PATHS = ("/healthz", "/readyz")
"""Told without a token: what asks for them restarts services, and learns nothing else."""


def make_app(
    state: LineState,
    *,
    no_reads: Path | None = None,
    token: str | None = None,
    hosts: tuple[str, ...] = (),
    use: Callable[[str], None] | None = None,
) -> Starlette:
    """Make the application.

    Parameters
    ----------
    state : LineState
        What it tells.
    no_reads : Path, optional
        The folder of the flight recorder, whose files are offered.
    token : str, optional
        Who asks must have it: as ``Authorization: Bearer``, or once as ``?token=``, which leaves a cookie.
    hosts : tuple of str
        Names by which it may be asked for; none: any. For a page on this machine alone they keep other
        pages' scripts from it.
    use : callable, optional
        Changes the job, or raises ValueError; it is asked for with a token alone.

    Returns
    -------
    app : starlette.applications.Starlette
        For any ASGI server.

    Raises
    ------
    MissingExtra
        Its packages are not installed.
    """
    with needs_extra("the page of a line", "starlette and prometheus-client", "line"):
        from prometheus_client import CollectorRegistry, generate_latest
        from prometheus_client.exposition import CONTENT_TYPE_LATEST
        from starlette.applications import Starlette
        from starlette.concurrency import run_in_threadpool
        from starlette.middleware import Middleware
        from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
        from starlette.routing import Route

    registry = CollectorRegistry(auto_describe=False)
    registry.register(LineCollector(state))
    static = {name: (files("evqr.page") / "static" / name).read_bytes() for name in ("page.html", *STATIC)}

    def page(request: Request) -> Response:
        return Response(static["page.html"], media_type="text/html")

    def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in STATIC:
            return PlainTextResponse("there is no such file", 404)
        return Response(static[name], media_type=STATIC[name])

    def whole_state(request: Request) -> Response:
        return JSONResponse({**state.snapshot(), "view": state.view()})

    def metrics(request: Request) -> Response:
        return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)

    def health(request: Request) -> Response:
        return PlainTextResponse("ok")

    def ready(request: Request) -> Response:
        return PlainTextResponse("not ready", 503) if state.problems else PlainTextResponse("ok")

    async def job(request: Request) -> Response:
        if use is None or token is None:
            return PlainTextResponse("the job is changed by who has a token: set one in [page]", 403)
        try:
            use(str((await request.json())["job"]))
        except (ValueError, KeyError, TypeError) as error:  # of a body that is no JSON, too
            return PlainTextResponse(" ".join(str(error).split()), 400)
        return JSONResponse({"job": state.snapshot()["job"]})

    async def no_read(request: Request) -> Response:
        found = _kept(no_reads, request.path_params["name"])
        if found is None:
            return PlainTextResponse("these events are not kept any more", 404)
        if request.path_params["kind"] == "events":
            return FileResponse(found, media_type="application/x-hdf5", filename=found.name)
        try:
            return Response(await run_in_threadpool(_picture, found), media_type="image/svg+xml")
        except EvqrError as error:
            return PlainTextResponse(str(error), 404)

    class Guard(BaseHTTPMiddleware):
        """Asks for the token, and adds headers to all answers."""

        async def dispatch(self, request: Request, call_next: RequestResponseEndpoint) -> Response:
            response = _refusal(request, token) if token is not None else None
            if response is None:
                response = await call_next(request)
            response.headers.update(HEADERS)
            return response

    middleware = [Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts))] if hosts else []
    return Starlette(
        routes=[
            Route("/", page),
            Route("/static/{name}", asset),
            Route("/api/state", whole_state),
            Route("/api/job", job, methods=["POST"]),
            Route("/metrics", metrics),
            Route("/healthz", health),
            Route("/readyz", ready),
            Route("/no-reads/{name}/{kind:str}", no_read),
        ],
        middleware=[*middleware, Middleware(Guard)],
    )


def _refusal(request: Request, token: str) -> Response | None:
    """Answer who does not have the token yet; None for who does."""
    from starlette.responses import PlainTextResponse, RedirectResponse

    if request.url.path in OPEN_PATHS:
        return None
    if _same(request.query_params.get("token", ""), token):
        there = RedirectResponse(request.url.path or "/")  # so that the token is not in the address any more
        there.set_cookie(COOKIE, token, httponly=True, samesite="strict")
        return there
    scheme, _, given = request.headers.get("Authorization", "").partition(" ")
    if _same(given if scheme.lower() == "bearer" else request.cookies.get(COOKIE, ""), token):
        return None
    return PlainTextResponse("a token is needed: open this page with ?token=...", 401)


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _kept(folder: Path | None, name: str) -> Path | None:
    """Find a file of the flight recorder; nothing else can be had by any name."""
    if folder is None:
        return None
    return next((file for file in folder.glob("*.h5") if file.name == name), None)


def _picture(path: Path) -> bytes:
    """Draw what the camera saw."""
    import io

    from evqr.output.overview import draw_recording
    from evqr.recording import open_recording, summarise

    with open_recording(path) as recording:
        figure = draw_recording(recording, summarise(recording))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg")
    return buffer.getvalue()
