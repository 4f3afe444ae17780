"""Access control of the page: only scripts of the page itself may open its websocket.

A browser lets any site open a websocket to this machine, and names the site in the
header ``Origin``. A site may also let its domain resolve to this machine (DNS
rebinding); the browser names that domain in the header ``Host``.
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

# Addresses that stand for all addresses of this machine.
EVERY = ("0.0.0.0", "::")


def names_of(host: str) -> frozenset[str]:
    """Host names by which a page may be opened, in addition to IP addresses.

    Args:
        host: Address at which the page is served.
    """
    own = socket.gethostname().lower()
    served = (own, f"{own}.local") if host in EVERY else (host.lower(),)
    return frozenset(("localhost", *served))


def refusal(headers: Any, names: frozenset[str]) -> str | None:
    """The reason to refuse a request; None to accept it.

    A request without Origin is accepted: browsers always send the header with a
    websocket, so the sender is a program, which gains nothing by using the page.

    Args:
        headers: Headers of the request, with the method ``get_all``.
        names: Host names by which the page may be opened.
    """
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not _leads_here(hosts[0], names):
        sent = brief(", ".join(hosts))
        known = ", ".join(sorted(names))
        return f"Host is {sent}, expected an IP address or one of: {known}"
    allowed = [f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")]
    if origins and (len(origins) > 1 or origins[0].lower() not in allowed):
        return f"Origin is {brief(', '.join(origins))}, expected {allowed[0]}"
    return None


def _leads_here(host: str, names: frozenset[str]) -> bool:
    """Whether a host is an IP address or a name of the page: safe from rebinding."""
    with suppress(ValueError):
        name = urlsplit(f"//{host}").hostname or ""
        return name in names or bool(ipaddress.ip_address(name))
    return False


def serve(viser: Any, host: str, port: int) -> Any:
    """Start a viser server that refuses requests of other origins, with code 403.

    viser does not pass on the headers of requests. So while the server starts,
    ``websockets.asyncio.server.serve`` is wrapped in a function that checks them.

    Args:
        viser: The module.
        host: Address to serve at.
        port: Port to serve at.

    Returns:
        The ``viser.ViserServer``.

    Raises:
        TominpmpError: If this version of viser opens websockets by another function.
    """
    from websockets.asyncio import server as websockets_server

    names, wrapped = names_of(host), []
    original: Callable[..., Any] = websockets_server.serve

    def checked(*args: Any, process_request: Any = None, **settings: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            reason = refusal(request.headers, names)
            if reason is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            return process_request and process_request(connection, request)

        wrapped.append(True)
        return original(*args, process_request=process, **settings)

    setattr(websockets_server, "serve", checked)  # noqa: B010
    try:
        server = viser.ViserServer(host, port, label="tominpmp")
    finally:
        setattr(websockets_server, "serve", original)  # noqa: B010
    if not wrapped:
        server.stop()
        raise TominpmpError(
            f"viser {viser.__version__} opens its page so that any site could drive "
            "it: expected viser 1.1, whose requests can be checked"
        )
    return server
