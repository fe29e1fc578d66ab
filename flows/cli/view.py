"""Serve the page of a scene until it is told to stop."""

from __future__ import annotations

import os
import signal
import sys
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from flows.cli.query import open_field
from slgaussian.formats.ply import load_ply
from slgaussian.viewer.auth import listen
from slgaussian.viewer.page.scene_page import gaussians_page, scene_page
from slgaussian.viewer.server import LiveField, app, serve


def serve_page(source: Path, host: str, port: int | None, settings: Mapping[str, Any]) -> None:
    """Show a field or a ``.ply`` in the browser until Ctrl-C or SIGTERM.

    ``settings`` say, by the name of the field's encoder, where its files are now. The address goes
    to the standard output; a browser is opened where there is a desktop and somebody at a terminal.

    Raises
    ------
    SLGaussianError
        If the source cannot be opened or shown, or the port is in use.
    """

    def terminate(number: int, frame: object) -> NoReturn:
        raise KeyboardInterrupt

    # Of both: a shell that starts this in the background has it ignore SIGINT.
    before = {sign: signal.signal(sign, terminate) for sign in (signal.SIGINT, signal.SIGTERM)}
    live = None
    try:
        access = listen(host, port)
        if source.suffix.lower() == ".ply" and not source.is_dir():
            page = gaussians_page(load_ply(source)[0], source.stem)
        else:
            live = LiveField(open_field(source, settings, rules=False)[1], source)
            page = scene_page(live.field, live=True)
        print(access.address, flush=True)
        if access.token:
            print("whoever has this address sees the scene and can change it", file=sys.stderr)
        print("Ctrl-C ends it", file=sys.stderr)
        if sys.stdout.isatty() and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(access.address)
        serve(app(page, access, live), access)
    except KeyboardInterrupt:
        lost = live is not None and live.unsaved
        print("\nstopped; changes were not saved" if lost else "\nstopped", file=sys.stderr)
    finally:
        for sign, handler in before.items():
            signal.signal(sign, handler)
