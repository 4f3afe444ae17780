"""Who may speak to the page: only what was loaded from it, and no browser elsewhere.

A browser lets any site open a websocket to this machine, and says by ``Origin`` which
site did. A site may also let its own name lead here; the browser says by ``Host`` which
name that is.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from tominpmp.exceptions import TominpmpError, brief

# Addresses that stand for every one of this machine.
EVERY = ("", "0.0.0.0", "::")


def names_of(host: str) -> frozenset[str]:
    """Names by which a page may be opened; addresses in numbers are no names.

    Args:
        host: Address that it is served at.
    """
    own = socket.gethostname().lower()
    served = (own, f"{own}.local") if host in EVERY else (host.lower(),)
    return frozenset(("localhost", *served))


def refusal(headers: Any, names: frozenset[str]) -> str | None:
    """Why a request is refused; None if it is not.

    Who sends no Origin is no browser, for these always do with a websocket: a program
    of this machine, which needs no page to do what it likes.

    Args:
        headers: Of the request, with the method ``get_all``.
        names: By which the page may be opened.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _leads_here(hosts[0], names):
        asked = brief(", ".join(hosts))
        known = ", ".join(sorted(names))
        return f"Host is {asked}, expected an address in numbers or one of: {known}"
    own = [f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")]
    if origins and (len(origins) > 1 or origins[0].lower() not in own):
        return f"Origin is {brief(', '.join(origins))}, expected {own[0]}"
    return None


def _leads_here(host: str, names: frozenset[str]) -> bool:
    """Whether nobody else can make a host lead here: an address in numbers, or ours."""
    with suppress(ValueError):
        name = urlsplit(f"//{host}").hostname or ""
        if name in names:
            return True
        ipaddress.ip_address(name)
        return True
    return False


def serve(viser: Any, host: str, port: int) -> Any:
    """Begin to serve a page that refuses whom it was not served to, by code 403.

    viser says nothing of the headers to whoever uses it. So what it opens the websocket
    with is called through a function that looks at them first.

    Args:
        viser: The module.
        host: Address to serve at.
        port: Port to serve at.

    Returns:
        The ``viser.ViserServer``.

    Raises:
        TominpmpError: If this viser opens websockets in another way.
    """
    from websockets.asyncio import server as opening

    names, guarded = names_of(host), []
    usual: Callable[..., Any] = opening.serve

    def checked(*args: Any, process_request: Any = None, **settings: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            why = refusal(request.headers, names)
            if why is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
            return process_request and process_request(connection, request)

        guarded.append(True)
        return usual(*args, process_request=process, **settings)

    setattr(opening, "serve", checked)  # noqa: B010
    try:
        server = viser.ViserServer(host, port, label="tominpmp")
    finally:
        setattr(opening, "serve", usual)  # noqa: B010
    if not guarded:
        server.stop()
        raise TominpmpError(
            f"viser {viser.__version__} opens its page so that any site could drive "
            "it: expected viser 1.1, whose requests can be checked"
        )
    return server
