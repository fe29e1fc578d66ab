"""HTTP server of a field's page: answers texts and changes the field.

All browsers that open the address share one field and one history of changes; each has its own
camera. The server reads no file after the start, and only ``save`` writes one.
"""

from __future__ import annotations

import base64
import logging
import threading
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn
from pydantic import StrictInt, StrictStr
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from slgaussian.components.config import Config
from slgaussian.edits import Edits
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.field import SemanticField
from slgaussian.formats import strict_json
from slgaussian.objects import rank_words
from slgaussian.viewer.auth import Access, Guard
from slgaussian.viewer.page.answers import PageAnswers
from slgaussian.viewer.page.packed import morton_order

MAX_BODY_BYTES = 2**16  # largest body of a request

HEADERS = {
    "Cache-Control": "no-store",
    # The URL may contain the token, so no referrer; and no site may frame the page (clickjacking).
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
}


class LiveField:
    """A field that pages query and change, with its earlier versions for undo; not thread-safe.

    Args:
        folder: Folder of the field, into which :meth:`save` writes changes.

    Attributes:
        field: The field with all changes so far.
        ids: list of int. Objects that have Gaussians, ascending, removed ones included: their order
            in a page.
    """

    def __init__(self, field: SemanticField, folder: Path) -> None:
        self.field, self.folder = field, folder
        self.ids = np.intersect1d(field.bank.ids, field.labels()).tolist()
        self._rows = np.searchsorted(field.bank.ids, self.ids)
        self._order = morton_order(field.gaussians.to_arrays()["means"])
        self._earlier: list[SemanticField] = []
        self._saved = field

    @cached_property
    def _answers(self) -> PageAnswers:
        camera = next(iter(self.field.cameras.values()))
        return PageAnswers(self.ids, self.field.with_changes(edits=Edits()).render(camera).ids)

    @property
    def unsaved(self) -> bool:
        """True if the field was changed since it was opened or saved."""
        return self.field is not self._saved

    def state(self) -> dict[str, Any]:
        """Return everything that a change can alter.

        For each of :attr:`ids`: ``names``, and ``words`` [[text, relevancy], ...], best first;
        ``removed``: ids; ``gone``: in base64, one bit for each Gaussian in the order of a page, 1
        if it is not drawn, least significant bit first, empty if all are drawn; ``taught``:
        words; ``unsaved`` and ``undo``: whether there are unsaved changes and changes to undo.
        """
        field, edits = self.field, self.field.edits
        words = rank_words(field)
        hidden = field.hidden[self._order] if edits.removed else np.zeros(0, bool)
        return {
            "names": [edits.names.get(id_, "") for id_ in self.ids],
            "words": [[[text, round(r, 4)] for text, r in words[row]] for row in self._rows],
            "removed": sorted(edits.removed),
            "gone": base64.b64encode(np.packbits(hidden, bitorder="little").tobytes()).decode(),
            "taught": list(edits.taught),
            "undo": bool(self._earlier),
            "unsaved": self.unsaved,
        }

    def query(self, texts: Sequence[str]) -> dict[str, Any]:
        """Answer texts as :meth:`slgaussian.viewer.page.answers.PageAnswers.ask`.

        A text that cannot be used has an error (``refused``).
        """
        answers: list[dict[str, Any]] = []
        for text in texts:
            try:
                answers += self._answers.ask(self.field, [text])
            except InputError as error:
                answers.append({"text": text, "refused": str(error)})
        return {"answers": answers}

    def change(self, changed: SemanticField) -> dict[str, Any]:
        """Replace the field by a changed one; return the state."""
        self._earlier.append(self.field)
        self.field = changed
        return self.state()

    def undo(self) -> dict[str, Any]:
        """Undo the last change, if there is one; return the state."""
        if self._earlier:
            self.field = self._earlier.pop()
        return self.state()

    def save(self) -> dict[str, Any]:
        """Write all changes into the folder; return the state. Raise InputError if this fails."""
        self.field.save_edits(self.folder)
        self._saved = self.field
        return self.state()


class Body(Config, title="request"):
    """Body of a call; each call reads what it needs."""

    texts: tuple[StrictStr, ...] = ()
    word: StrictStr = ""
    object: StrictInt = 0


Call = Callable[[LiveField, Body], dict[str, Any]]

CALLS: dict[str, Call] = {
    "state": lambda live, body: live.state(),
    "query": lambda live, body: live.query(body.texts),
    "teach": lambda live, body: live.change(live.field.teach(body.word, body.object)),
    "name": lambda live, body: live.change(live.field.rename(body.object, body.word)),
    "remove": lambda live, body: live.change(live.field.without([body.object])),
    "restore": lambda live, body: live.change(live.field.restore([body.object])),
    "undo": lambda live, body: live.undo(),
    "save": lambda live, body: live.save(),
}
"""The functions behind ``POST /api/NAME``, by name."""


def app(page: str, access: Access, live: LiveField) -> Starlette:
    """Build the application that serves ``page`` at ``/`` and :data:`CALLS` at ``POST /api/NAME``.

    Bodies and answers are JSON; a call that fails has status 400 and ``{"error": sentence}``.
    """
    lock = threading.Lock()

    def call_locking(call: Call, data: bytes) -> dict[str, Any]:
        try:
            values = strict_json.parse(data)
        except ValueError:
            values = None
        if not isinstance(values, dict):
            raise InputError("the body of the request is not a JSON object, expected one")
        body = Body(**values)
        with lock:
            return call(live, body)

    async def show(request: Request) -> Response:
        return HTMLResponse(page, headers=HEADERS)

    async def respond(call: Call, request: Request) -> Response:
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_BODY_BYTES:
                return JSONResponse(
                    {"error": f"found more than {MAX_BODY_BYTES} bytes"}, 413, HEADERS
                )
        try:
            return JSONResponse(await run_in_threadpool(call_locking, call, body), headers=HEADERS)
        except SLGaussianError as error:
            return JSONResponse({"error": str(error)}, 400, HEADERS)

    calls = [
        Route(f"/api/{name}", partial(respond, call), methods=["POST"])
        for name, call in CALLS.items()
    ]
    return Starlette(
        routes=[Route("/", show), *calls], middleware=[Middleware(Guard, access=access)]
    )


def serve(application: Starlette, access: Access) -> None:
    """Serve until SIGINT or SIGTERM, which is then passed to the handler installed before."""
    config = uvicorn.Config(
        application,
        log_config=None,
        access_log=False,
        lifespan="off",
        ws="none",
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    # A response still being sent when the user stops the viewer is no error to report.
    logger = logging.getLogger("uvicorn.error")
    logger.addFilter(lambda record: "graceful shutdown" not in record.getMessage())
    uvicorn.Server(config).run(sockets=[access.listener])
