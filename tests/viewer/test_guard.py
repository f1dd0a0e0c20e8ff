"""Who may open the viewer's page and its websocket: only those who know its address, and no page of another site."""

import functools
import http.server
import json
import shutil
import socket
import threading
import urllib.error
import urllib.request
import warnings
from types import SimpleNamespace

import pytest

import torchjoint as tj

viser = pytest.importorskip("viser", reason="the viewer needs viser: pip install 'torchjoint[viewer]'")
from websockets.exceptions import InvalidStatus  # noqa: E402 (a package that viser needs)
from websockets.sync.client import connect  # noqa: E402

from torchjoint.viewer.server import Page  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def viewer(out):
    from torchjoint.viewer.app import Viewer

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        viewer = Viewer(tj.load_result(out, edits=False), page=Page(port=8980))
    yield viewer
    viewer.stop()


def place(viewer):
    return f"127.0.0.1:{viewer.server.get_port()}"


def answer(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=10) as response:
            return response.status
    except urllib.error.HTTPError as error:
        return error.code


def opens(viewer, url, **options):
    """Whether the websocket is opened and sends something."""
    try:
        with connect(url, subprotocols=[PROTOCOL], max_size=None, **options) as client:
            return len(client.recv(timeout=10)) > 0
    except InvalidStatus as error:
        return error.response.status_code != 403


def test_what_is_no_browser_gives_no_traceback(viewer, caplog):
    for request in (b"", b"GET / HTTP/1.0\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", viewer.server.get_port()), timeout=10) as client:
            client.sendall(request)
            client.shutdown(socket.SHUT_WR)
            assert client.recv(100) == b""  # then the server has dropped it
    assert caplog.records == []


def test_a_page_that_has_ended_draws_nothing(out):
    from torchjoint.viewer.app import Viewer

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        viewer, drawn = Viewer(tj.load_result(out, edits=False), page=Page(port=8985)), []
    viewer._guarded(drawn.append, 1)
    viewer.stop()  # while it counts pixels in the background
    viewer._guarded(drawn.append, 2)
    viewer._cloud, viewer._stand_at = None, drawn.append
    for element in (viewer._panel.size, viewer._panel.stand):
        element._impl.update_cb[0](SimpleNamespace(client=3))
    assert drawn == [1]


def test_the_page_needs_its_whole_address(viewer):
    assert viewer.page.url.startswith(f"http://{place(viewer)}/")
    assert len(viewer.page.url) > len(f"http://{place(viewer)}/") + 30
    assert answer(viewer.page.url) == 200
    assert answer(f"{viewer.page.url}?websocket=x") == 200
    for wrong in (f"http://{place(viewer)}/", viewer.page.url[:-2], f"http://{place(viewer)}/index.html"):
        assert answer(wrong) == 403


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_a_name_of_another_site_that_leads_here(viewer, host):
    assert answer(viewer.page.url, Host=host) == 403


@pytest.mark.parametrize("host", ["localhost:9000", "127.0.0.1", "[::1]:7"])
def test_a_forwarded_port(viewer, host):
    assert answer(viewer.page.url, Host=host) == 200


def test_a_machine_whose_name_has_capitals(viewer, monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "DESKTOP-7K")
    page = Page(port=8985)
    assert [answer(page.url, Host=host) for host in ("DESKTOP-7K:8985", "desktop-7k", "desktop-8k")] == [200, 200, 403]
    page.stop()


ODD = [
    b"GET /%(token)s/ HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /%(token)s/ HTTP/1.1\r\nHost: [\r\n\r\n",
    b"GET /\xff HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
]


@pytest.mark.parametrize("request_", ODD, ids=["two hosts", "half an address", "no text"])
def test_an_odd_request_is_refused_as_any_other(viewer, request_):
    with socket.create_connection(("127.0.0.1", viewer.server.get_port()), timeout=10) as connection:
        connection.sendall(request_.replace(b"%(token)s", viewer.page.url.split("/")[3].encode()))
        assert connection.recv(100).split(b"\r\n")[0] == b"HTTP/1.1 403 Forbidden"


def test_the_websocket_needs_it_too(viewer):
    url = viewer.page.url.replace("http", "ws").rstrip("/")
    assert opens(viewer, url)
    assert opens(viewer, url, origin=f"http://{place(viewer)}")
    assert not opens(viewer, f"ws://{place(viewer)}")
    for origin in ("http://evil.example", "http://127.0.0.1:1", "null", f"http://{place(viewer)}.evil.example"):
        assert not opens(viewer, url, origin=origin)
    rebound = socket.create_connection(("127.0.0.1", viewer.server.get_port()))  # as after DNS rebinding
    assert not opens(viewer, url.replace("127.0.0.1", "evil.example"), sock=rebound, origin="http://evil.example:8980")


def test_the_address_is_another_one_each_time(viewer):
    page = Page(port=8985)
    assert page.url.split("/")[3] != viewer.page.url.split("/")[3]
    page.stop()


def test_what_only_this_machine_reaches():
    from torchjoint.viewer.server import is_loopback

    assert [is_loopback(host) for host in ("127.0.0.1", "localhost", "::1", "127.9.9.9")] == [True] * 4
    assert [is_loopback(host) for host in ("0.0.0.0", "::", "10.0.0.1", "kitchen")] == [False] * 4


PAGE = """<script>
const results = [];
const attempts = JSON.parse('%s');
Promise.all(attempts.map(url => new Promise(end => {
    const socket = new WebSocket(url, ['%s']);
    socket.onmessage = () => end('read');
    socket.onerror = () => end('refused');
}))).then(all => document.title = all.join(' '));
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser: apt-get install chromium")
def test_a_page_of_another_port_reads_nothing(viewer, tmp_path):
    sync_api = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright")
    own = viewer.page.url.replace("http", "ws").rstrip("/")
    attempts = [
        f"ws://{place(viewer)}",
        own,
        f"ws://localhost:{viewer.server.get_port()}",
    ]  # the second knows the token
    (tmp_path / "index.html").write_text(PAGE % (json.dumps(attempts), PROTOCOL))
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    other = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=other.serve_forever, daemon=True).start()
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{other.server_port}/")
        page.wait_for_function("document.title != '' && !document.title.includes('127')", timeout=240_000)
        assert page.title() == "refused refused refused"
        mine = browser.new_page()
        mine.goto(viewer.page.url)
        mine.wait_for_selector("#tj-image")  # the page itself works
        browser.close()
    other.shutdown()
    other.server_close()
