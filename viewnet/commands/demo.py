"""Try a trained network in a browser.

Open a page on which to drop an image, mark its object and see the viewpoint on a compass, every hypothesis, and the
object rendered from there, from anywhere else, and as a 3-D model. Nothing is fetched from the network or sent to it;
files that visitors send are deleted after an hour, and when the page ends.

Examples:

    viewnet demo --model 0123456789ab --open
    viewnet demo --model car --examples street.jpg yard.jpg
    viewnet demo --model saved/car --host 0.0.0.0 --port 8080         for everybody who can reach this machine
"""

import socket
from typing import Any

from viewnet.commands.options import MODEL, Options, argument
from viewnet.errors import ViewnetError

LAUNCH: dict[str, Any] = {"prevent_thread_lock": True, "quiet": True, "show_error": False, "max_file_size": "20mb"}
LAUNCH |= {"footer_links": [], "run_history": False, "ssr_mode": False}
OFFERED = "images to offer on the page, such as photographs (default: drawn ones)"
SHARED = "yes: a public address too, by a tunnel through gradio's servers (default: no)"
ARGUMENTS = (
    *MODEL,
    argument("--host", "the address to listen at (default: 127.0.0.1, this machine)", default="127.0.0.1"),
    argument("--port", "default: 7860", type=int, default=7860),
    argument("--share", SHARED, choices=["no", "yes"], default="no"),
    argument("--examples", OFFERED, nargs="+", default=[]),
    argument("--open", "open the page in the browser", action="store_true"),
)


def run(options: Options) -> None:
    """Serve the page until it is interrupted."""
    page = start(options)
    print(f"viewnet demo: {page.local_url} (Ctrl+C ends it)", flush=True)
    if page.share_url:
        print(f"viewnet demo: {page.share_url}, for everybody", flush=True)
    page.block_thread()


def start(options: Options) -> Any:
    """The page (gradio.Blocks), served by a thread.

    ViewnetError without gradio or a model, and for an address where it cannot listen or does not answer.
    """
    try:
        import gradio  # noqa: F401
    except ImportError:
        raise ViewnetError('demo: gradio is not installed: pip install "viewnet[demo]"') from None
    if not 0 < options.port < 65536:
        raise ViewnetError(f"--port {options.port}: expected 1 to 65535")
    _check_free(options.host, options.port)
    from viewnet.estimator import ViewpointEstimator
    from viewnet.estimator.demo import app, examples

    estimator = ViewpointEstimator.from_pretrained(options.model, device=options.device)
    shown = examples.of_files(options.examples) or examples.rendered(estimator)
    page = app.Page(estimator, shown).blocks
    address = {"server_name": options.host, "server_port": options.port, "share": options.share == "yes"}
    try:
        page.launch(**address, inbrowser=options.open, theme=app.theme(), css_paths=app.STYLE, **LAUNCH)
    except ValueError:  # gradio could not reach its own page
        page.close()
        remedy = "start it again, and if a proxy is set (http_proxy), except this address from it (no_proxy)"
        raise ViewnetError(f"{options.host}:{options.port}: the page does not answer: {remedy}") from None
    return page


def _check_free(host: str, port: int) -> None:
    """Raise ViewnetError for an address at which nothing can listen; gradio's server would fail in its own thread."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        socket.create_server(address[:2], family=family).close()
    except (OSError, UnicodeError) as error:  # the latter for what cannot be a host's name
        why = getattr(error, "strerror", None) or "no name of a host"
        reason = f"cannot listen there ({why}): choose another --port or --host"
        raise ViewnetError(f"{host}:{port}: {reason}") from None
