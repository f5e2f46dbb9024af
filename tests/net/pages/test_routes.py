"""The pages beside the WebSocket and the files that they need; who may read them."""

from __future__ import annotations

import asyncio
import gzip
import http.client
import re
from importlib import resources

import aiohttp
import pytest

from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import WireOptions
from glsplat.net.pages import Site, page_files, read_folder
from glsplat.net.server import ServerConfig
from tests.net.wire import HANG

TOKEN = "0123456789abcdef"
GUARDED = ServerConfig(port=0, access=Access(token=TOKEN))


def ask(serve, *requests, config=None, **options):
    """Return (status, headers, body) of each (method, path, headers), sent as they are on one connection."""

    def talk(port):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=HANG)
        answers = []
        for method, path, headers in requests:
            connection.request(method, path, headers=headers)
            response = connection.getresponse()
            answers.append((response.status, response.headers, response.read()))
        connection.close()
        return answers

    async def main():
        async with serve(config=config, **options) as server:
            return await asyncio.to_thread(talk, server.port)

    return asyncio.run(main())


def test_every_file_of_the_page_is_served_without_a_token(serve):
    files = page_files()
    paths = sorted(files)
    answers = ask(serve, *(("GET", f"/vr/{path}", {}) for path in ["", *paths]), config=GUARDED)
    assert answers[0][2] == answers[1 + paths.index("index.html")][2]
    types = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
    for path, (status, headers, body) in zip(paths, answers[1:], strict=True):
        plain = re.sub(rb'<link rel="modulepreload" href="[^"]*">\n *', b"", body) if path.endswith(".html") else body
        assert status == 200 and plain == files[path], path
        kind = headers["Content-Type"].split(";")[0]
        assert kind == types.get(path.rpartition(".")[2], kind)
        assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cross-Origin-Opener-Policy"] == headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["Permissions-Policy"] == "xr-spatial-tracking=(self)"
        policy = dict(part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";"))
        assert policy.pop("img-src") == "'self' blob:" and "unsafe" not in str(policy)
        assert policy.pop("default-src") == policy["base-uri"] == policy["frame-ancestors"] == "'none'"
        assert policy["script-src"] == policy["connect-src"] == policy["worker-src"] == "'self'"


@pytest.mark.extra(name="operations")
async def test_no_other_site_shows_or_measures_what_is_answered(serve, cameras):
    async with serve() as server, Client(server.url) as client, aiohttp.ClientSession() as http:
        await client.render(cameras)
        routes = {route.resource.canonical for route in server._runner.app.router.routes()} - {"/ws", "/vr"}
        names = {"{name}": "default", "{number}": "1", "{path}": "index.html", "{sha256}": "0" * 64}
        found = {}
        for path in (*routes, "/nosuch"):
            for name, value in names.items():
                path = path.replace(name, value)
            async with http.get(f"http://127.0.0.1:{server.port}{path}") as response:
                found[path] = response.status, response.headers.get("Cross-Origin-Resource-Policy")
    assert {policy for _, policy in found.values()} == {"same-origin"}, found
    assert found["/pictures/1"][0] == found["/thumbnails/default"][0] == found["/status.json"][0] == 200
    assert not any("{" in path for path in found), found


def test_a_browser_that_has_a_file_is_not_sent_it_again(serve):
    ((_, headers, body),) = ask(serve, ("GET", "/vr/index.html", {}))
    tag = headers["ETag"]
    again, other, head, head_again = ask(
        serve,
        ("GET", "/vr/index.html", {"If-None-Match": f'"x", {tag}'}),
        ("GET", "/vr/index.html", {"If-None-Match": '"x"'}),
        ("HEAD", "/vr/index.html", {}),
        ("HEAD", "/vr/index.html", {"If-None-Match": tag}),
    )
    assert again[0] == head_again[0] == 304 and not again[2] and again[1]["ETag"] == tag
    assert "Content-Security-Policy" in again[1] and again[1]["Cache-Control"] == "no-cache"
    assert other[0] == 200 and other[2] == body
    assert head[0] == 200 and head[2] == b"" and int(head[1]["Content-Length"]) == len(body)


def test_text_goes_packed_to_who_takes_that(serve):
    plain, packed = ask(serve, *(("GET", "/vr/main.js", {"Accept-Encoding": how}) for how in ("identity", "br, gzip")))
    assert gzip.decompress(packed[2]) == plain[2] and 3 * len(packed[2]) < 2 * len(plain[2])
    assert packed[1]["Content-Encoding"] == "gzip" and "Content-Encoding" not in plain[1]
    assert packed[1]["ETag"] != plain[1]["ETag"] and packed[1]["Vary"] == plain[1]["Vary"] == "Accept-Encoding"
    tags = {"Accept-Encoding": "gzip", "If-None-Match": packed[1]["ETag"]}
    ((status, _, body),) = ask(serve, ("GET", "/vr/main.js", tags))
    assert (status, body) == (304, b"")


def test_the_address_without_a_slash_leads_to_the_page_and_keeps_what_was_asked(serve):
    plain, asking = ask(serve, ("GET", "/vr", {}), ("GET", "/vr?view=mirror&x=%0d%0aA:b", {}), config=GUARDED)
    assert plain[0] == asking[0] == 308
    assert plain[1]["Location"] == "vr/"  # relative: a proxy may serve it under another path
    assert asking[1]["Location"] == "vr/?view=mirror&x=%0D%0AA:b" or "%0d%0a" in asking[1]["Location"]


@pytest.mark.parametrize(
    "path",
    [
        *("/vr/../stats", "/vr/..%2fstats", "/vr/%2e%2e/stats", "//vr/../stats", "/vr/%2e%2e%2f__init__.py"),
        *("/vr//etc/passwd", "/vr/index.html%00.js", "/vr/.", "/vr/\\stats", "/vrx"),
        *("/motions/../stats", "/motions/..%2fidle", "/motions/idle.json", "/motions/%2e%2e%2fdata%2fidle"),
    ],
)
def test_no_path_leads_out_of_the_page_or_around_the_token(serve, path):
    ((status, _, body),) = ask(serve, ("GET", path, {}), config=GUARDED)
    assert status in (400, 401, 404), (status, body)
    ((status, _, body),) = ask(serve, ("GET", path, {"Authorization": f"Bearer {TOKEN}"}), config=GUARDED)
    assert status == 404 or (status == 200 and path.endswith(("stats", "session")) and body.startswith(b"{"))


def test_other_addresses_want_the_token_and_other_pages_get_nothing(serve):
    secret, foreign = {"Authorization": f"Bearer {TOKEN}"}, {"Origin": "http://evil.example"}
    for path in ("/session", "/motions/idle", "/recording", "/stats"):
        requests = [("GET", path, headers) for headers in ({}, secret, secret | foreign)]
        assert [answer[0] for answer in ask(serve, *requests, config=GUARDED)] == [401, 200, 403]
    answers = ask(serve, ("GET", "/vr/", foreign), ("POST", "/vr/", {}), config=GUARDED)
    assert [answer[0] for answer in answers] == [403, 401]


def test_wrong_tokens_on_the_page_are_no_guesses(serve):
    """A browser that was given a token sends it to every address."""
    wrong = {"Authorization": "Bearer wrong-wrong-wrong"}
    answers = ask(serve, *[("GET", "/vr/", wrong)] * 20, ("GET", "/stats", wrong), config=GUARDED)
    assert [a[0] for a in answers] == [200] * 20 + [401]


def test_a_page_of_many_files_costs_a_few_visits(serve):
    limits = Limits(visits=0.001, visits_burst=10)
    answers = ask(serve, *[("GET", "/vr/", {})] * 89, config=ServerConfig(port=0, limits=limits))
    assert {a[0] for a in answers} == {200}  # the connection itself is one
    answers = ask(serve, *[("GET", "/session", {})] * 10, config=ServerConfig(port=0, limits=limits))
    assert [a[0] for a in answers] == [200] * 9 + [429]


@pytest.mark.extra(name="browser")
async def test_what_the_server_offers(serve):
    offered = [
        AvatarInfo(name="ann", solver=lambda height, span: None, height=1.71234567, parts=frozenset({"head"})),
        AvatarInfo(name="a room"),
    ]
    config = ServerConfig(port=0, max_clients=1, wire=WireOptions(size=(640, 480), quality=70))
    async with serve(config=config, offered=offered) as server, aiohttp.ClientSession() as web:
        url = f"http://127.0.0.1:{server.port}/session"
        await server.all_offered.wait()
        async with web.get(url) as answer:
            before = await answer.json()
        async with Client(server.url), web.get(url) as answer:
            during = await answer.json()
    plain = {"title": "", "made": False, "hand_out": None}
    assert before["avatars"] == [
        {"name": "ann", "height": 1.7123, "tracking": True, "head": True, **plain},
        {"name": "a room", "height": None, "tracking": False, "head": False, **plain},
    ]
    assert (before["size"], before["quality"], before["window"], before["max_side"]) == ([640, 480], 70, 2, 2048)
    assert (before["clients"], before["max_clients"], before["full"], before["loading"]) == (0, 1, False, False)
    assert during == before | {"clients": 1, "full": True}


def test_motions_and_recording_are_the_files_of_the_package(serve):
    data = resources.files("glsplat.data")
    paths = {"/motions/idle": "idle.json", "/motions/walk": "walk.json", "/recording": "recording.jsonl"}
    *found, unknown = ask(serve, *(("GET", path, {}) for path in [*paths, "/motions/x"]))
    for (status, headers, body), name in zip(found, paths.values(), strict=True):
        assert status == 200 and body == (data / name).read_bytes()
        assert headers["Content-Security-Policy"].startswith("default-src 'none'")
    assert found[0][1]["Content-Type"].startswith("application/json")
    assert unknown[0] == 404 and b"idle, walk" in unknown[2] and b"/x" not in unknown[2]


def test_a_page_names_each_module_that_its_scripts_import():
    texts = {
        "index.html": '<head>\n  <script type="module" src="main.js"></script>\n</head>',
        "deep/other.html": '<script type="module" src="../main.js"></script>',
        "plain.html": "<p>import { a } from './a.js'</p>",
        "main.js": "// import './no.js'\nimport { a } from './b/a.js';\nimport {\n  c,\n} from './c.js';\n"
        "import './gone.js';\n"
        "const late = () => import('./late.js');\n",
        "b/a.js": "import { c } from '../c.js';\nexport { d } from './d.js';\n",
        "b/d.js": "import '../main.js';\nnew Worker('./worker.js');\n",
        "c.js": "export const c = 1;\n",
        "late.js": "import './c.js';\n",
        "no.js": "",
    }
    site = Site({name: text.encode() for name, text in texts.items()})
    named = {name: re.findall(rb'modulepreload" href="([^"]+)"', site.files[name].body) for name in site.files}
    assert named["index.html"] == [b"main.js", b"b/a.js", b"c.js", b"b/d.js"]
    assert named["deep/other.html"] == [b"../main.js", b"../b/a.js", b"../c.js", b"../b/d.js"]
    assert not any(found for name, found in named.items() if name not in ("index.html", "deep/other.html"))
    assert site.files["plain.html"].body.decode() == texts["plain.html"]


def test_only_files_of_known_types_are_read(tmp_path):
    for name in ("index.html", "a/b.js", "notes.md", ".hidden", "a/c"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
    assert dict(read_folder(tmp_path)) == {"a/b.js": b"x", "index.html": b"x"}
