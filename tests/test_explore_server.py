"""Check the server and the worker of `pssf explore` over HTTP, and the cache of imaging stages."""

import dataclasses
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib
import zipfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from io import BytesIO

import numpy as np
import pytest

import pssf
from pssf.core.checks import InputError
from pssf.core.processes.worker_processes import WorkersLostError
from pssf.data.imaging.explore_table import load_page_settings
from pssf.data.knees.field_definitions import load_field_specs
from pssf.explore import handlers, prefetch
from pssf.explore.page_listing import build_listing, knee_to_page_dict
from pssf.explore.page_server import _bind_socket
from pssf.explore.page_worker import SupersededError, Worker
from pssf.explore.python_snippet import format_python_lines
from pssf.explore.request_guard import MAX_BODY_BYTES, build_page_policy
from pssf.explore.request_schema import (
    coarsen_protocol,
    parse_state,
    resolve_state,
)
from pssf.explore.stage_cache import ENGINE, StageCache
from pssf.io.meshes import knee_viewer
from pssf.model.knee import Cyst, Knee, Osteophyte
from pssf.model.protocol import protocol_to_dict
from pssf.simulation import simulate

SIDE = 96


def make_small_protocol(**changes):
    """Return the reference protocol with a coarse detector of the same field."""
    protocol = pssf.load_protocol("reference")
    return dataclasses.replace(protocol, rows=SIDE, cols=SIDE, pixel_mm=307.2 / SIDE, **changes)


def make_state(**changes):
    """Return the state that the page sends to the server."""
    knee = {**knee_to_page_dict(Knee()), "limb_ap_mm": None, "fat_mm": None}
    return {
        "tab": "t",
        "knee": knee,
        "protocol": protocol_to_dict(make_small_protocol()),
        "seed": 0,
        "processing": "linear",
        **changes,
    }


def make_request(**changes):
    """Return a resolved request with changes of the state."""
    return resolve_state(parse_state(json.dumps(make_state(**changes)).encode()))


@pytest.fixture(scope="module")
def cache():
    return StageCache()


# --- cache of imaging stages ---


def test_technique_changes_reuse_the_rays_but_geometry_changes_do_not(cache):
    first = cache.simulate_image(Knee(), make_small_protocol(), 0)
    again = [
        cache.simulate_image(Knee(), make_small_protocol(tube_kv=80.0), 0),
        cache.simulate_image(Knee(), make_small_protocol(mas=4.0), 5),
    ]
    assert all(made.cached_paths is first.cached_paths and made.rays_traced == 0 for made in again)
    other = cache.simulate_image(Knee(), make_small_protocol(sod_mm=900.0), 0)
    assert other.rays_traced > 0
    assert other.built is first.built


def test_a_new_seed_repeats_only_the_noise_stages(cache):
    cache.simulate_image(Knee(), make_small_protocol(), 0)
    made = cache.simulate_image(Knee(), make_small_protocol(), 1)
    assert set(made.seconds) == {"anatomy", "rays", "quantum noise", "detector blur", "readout"}
    assert (made.image.pixels == simulate(made.built, make_small_protocol(), rng=1, engine=ENGINE).pixels).all()


OTHER = {
    "name": "other", "tube_kv": 82.0, "mas": 3.0, "filtration_mm_al": 4.0, "anode_angle_deg": 15.0,
    "focal_spot_mm": 1.4, "sdd_mm": 1200.0, "sod_mm": 940.0, "beam_angle_deg": 4.0, "rows": 80, "cols": 88,
    "pixel_mm": 3.0, "mono_kev": 50.0, "filters": (("Cu@8.96", 0.1),), "spectrum": ((30.0, 1e5), (60.0, 2e5)),
    "heel": "anode_distal", "projection": "PA", "flexion_deg": 10.0,
    "tibia_forward_deg": 5.0, "rotation_deg": 5.0, "tilt_deg": 3.0, "beam_along": "medial_plateau",
    "centre_x_mm": 9.0, "centre_z_mm": -9.0, "detector_offset_x_mm": 7.0, "detector_offset_z_mm": -5.0,
    "field_width_mm": 150.0, "field_height_mm": 160.0, "marker": "R",
    "texture": "none", "focal_spot_shape": "gaussian", "focal_spot": "sampled", "subpixels": 2,
    "scatter": "none", "scatter_photons": 4000,
    "grid_ratio": 10.0, "grid_lines_per_cm": 60.0, "detector": "gos", "detector_blur": "none",
    "dead_pixels": 0.01, "noise": "none",
}  # fmt: skip
# All optional features are on, so that every later stage depends on earlier ones.
FULL = {"grid_ratio": 8.0, "marker": "L", "dead_pixels": 0.005, "field_width_mm": 200.0, "field_height_mm": 210.0}


@pytest.fixture(scope="module")
def full_pixels():
    return pssf.simulate(Knee(), make_small_protocol(**FULL), rng=3, engine=ENGINE).pixels


@pytest.mark.parametrize(
    "name", [one.name for one in dataclasses.fields(pssf.Protocol) if one.name != "knee_distance_mm"]
)
def test_the_cache_gives_the_pixels_of_simulate_for_every_changed_field(name, cache, full_pixels):
    assert set(OTHER) == {one.name for one in dataclasses.fields(pssf.Protocol)} - {"knee_distance_mm"}
    before = make_small_protocol(**FULL)
    after = dataclasses.replace(before, **{name: OTHER[name]})
    cache.simulate_image(Knee(), before, 3)
    made = cache.simulate_image(Knee(), after, 3)
    assert (made.image.pixels == simulate(made.built, after, rng=3, engine=ENGINE).pixels).all()
    assert (cache.simulate_image(Knee(), before, 3).image.pixels == full_pixels).all()


@pytest.mark.parametrize("changes", [{}, {"scatter": "monte_carlo", "scatter_photons": 4000}])
def test_a_new_seed_gives_the_pixels_of_simulate_with_either_scatter(changes, cache):
    for seed in (1, 2, 1):
        made = cache.simulate_image(Knee(), make_small_protocol(**changes), seed)
        assert (
            made.image.pixels == simulate(made.built, make_small_protocol(**changes), rng=seed, engine=ENGINE).pixels
        ).all()


def test_a_superseded_request_stops_and_leaves_the_cache_valid():
    steps_left = [100]

    def step():
        steps_left[0] -= 1
        if steps_left[0] < 0:
            raise SupersededError

    cache = StageCache(step)
    cache.simulate_image(Knee(), make_small_protocol(), 0)
    for stages in range(4):
        steps_left[0] = stages
        with pytest.raises(SupersededError):
            cache.simulate_image(Knee(), make_small_protocol(tube_kv=75.0 + stages), 0)
    steps_left[0] = 100
    made = cache.simulate_image(Knee(), make_small_protocol(), 0)
    assert (made.image.pixels == simulate(made.built, make_small_protocol(), engine=ENGINE).pixels).all()


def test_the_cache_is_limited_by_its_number_of_pixels(cache, monkeypatch):
    monkeypatch.setattr("pssf.explore.stage_cache._MOST_PIXELS", 3 * SIDE**2)
    for angle in range(6):
        cache.simulate_image(Knee(), make_small_protocol(beam_angle_deg=float(angle)), 0)
    assert len(cache._traced) == 3
    assert cache.simulate_image(Knee(), make_small_protocol(beam_angle_deg=5.0), 0).rays_traced == 0


# --- request handlers ---


def test_a_coarsened_protocol_keeps_the_field_of_view():
    whole = pssf.load_protocol("fixed_flexion")
    coarse = coarsen_protocol(dataclasses.replace(whole, scatter="monte_carlo"), 512)
    assert max(coarse.rows, coarse.cols) == 512
    assert coarse.rows * coarse.pixel_mm == pytest.approx(whole.rows * whole.pixel_mm)
    assert coarse.scatter == "kernel"
    assert coarsen_protocol(whole, 0) is whole


@pytest.mark.parametrize("processing", load_page_settings().processing)
def test_displayed_pixels_equal_those_of_render_for_display(processing, cache):
    header, content = handlers.handle_radiograph(cache, make_request(processing=processing))
    displayed = np.frombuffer(content, "<u2").reshape(header["rows"], header["cols"])
    direct = pssf.simulate(Knee(), make_small_protocol(), engine=ENGINE).pixels
    if processing != "linear":
        direct = pssf.render_for_display(
            direct, bits=16, processing=processing, pixel_mm=make_small_protocol().pixel_mm
        )
    assert (displayed == direct).all()


def test_exposure_measures_are_proportional_to_the_mas(cache):
    header, _ = handlers.handle_radiograph(cache, make_request())
    twice, _ = handlers.handle_radiograph(cache, make_request(protocol=protocol_to_dict(make_small_protocol(mas=4.0))))
    for name in ("exposure_index", "entrance_kerma_ugy"):
        assert twice[name] == pytest.approx(2 * header[name], rel=1e-5)
    assert twice["spr_limb"] == pytest.approx(header["spr_limb"], rel=1e-5)
    none, _ = handlers.handle_radiograph(
        cache, make_request(protocol=protocol_to_dict(make_small_protocol(scatter="none")))
    )
    assert none["spr_limb"] is none["spr_joint"] is None
    assert header["audit"]["unrepaired"] == 0
    assert header["truth"]["jsw_medial_mm"] == pytest.approx(5.0, abs=1e-3)


def test_path_lengths_at_the_cursor_equal_traced_path_lengths(cache):
    handlers.handle_radiograph(cache, make_request())
    header, _ = handlers.handle_probe(cache, make_request(row=40, col=45))
    paths = pssf.trace(pssf.build(Knee()).scene, make_small_protocol(), engine=ENGINE).path_mm
    along = {name: float(values[40, 45]) for name, values in paths.items() if values[40, 45] > 5e-4}
    assert header["path_mm"] == along
    assert handlers.handle_probe(cache, make_request(row=SIDE, col=0))[0]["path_mm"] is None
    assert handlers.handle_probe(cache, make_request(knee=knee_to_page_dict(Knee(varus_deg=1.0))))[0]["path_mm"] is None


def test_served_masks_equal_those_of_the_truth(cache):
    header, content = handlers.handle_masks(cache, make_request())
    masks = pssf.simulate(Knee(), make_small_protocol(), keep=("masks",), engine=ENGINE).truth.masks
    assert header["names"] == list(masks)
    bits = np.unpackbits(np.frombuffer(content, np.uint8)).reshape(len(masks), -1)[:, : SIDE * SIDE]
    for got, mask in zip(bits, masks.values(), strict=True):
        assert (got.reshape(SIDE, SIDE) == mask).all()


def test_the_3d_view_contains_beam_and_detector_at_their_locations(cache):
    _, content = handlers.handle_solids(cache, make_request())
    page = content.decode()
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    low, high = np.array(data["bounds"])
    # The upper bound is the detector plane plus the thickness of the detector.
    assert high[1] == pytest.approx(200.0 + knee_viewer._PLATE_MM)
    assert high[0] - low[0] == pytest.approx(307.2)
    assert {"beam", "detector"} <= {layer["label"] for layer in data["layers"]}
    assert data["radiograph"] is None
    assert "unsafe" not in build_page_policy(page)


@pytest.mark.parametrize("kind", ["tif", "dcm"])
def test_an_exported_file_contains_the_full_resolution_radiograph(kind, cache, tmp_path):
    header, content = handlers.handle_file(cache, make_request(kind=kind, side=32, seed=4))
    path = tmp_path / header["name"]
    path.write_bytes(content)
    loaded = pssf.load(path)
    assert loaded == pssf.simulate(Knee(), make_small_protocol(), rng=4, engine=ENGINE)


def test_exported_toml_files_load_as_the_same_knee_and_protocol(cache, tmp_path):
    for kind, given, read in (
        ("knee.toml", Knee(), lambda path: pssf.Knee(**tomllib.loads(path.read_text()))),
        ("protocol.toml", make_small_protocol(), pssf.load_protocol),
    ):
        path = tmp_path / kind
        path.write_bytes(handlers.handle_file(cache, make_request(kind=kind))[1])
        assert dataclasses.replace(read(path), name=given.name) == given if kind[0] == "p" else read(path) == given


def test_meshes_are_exported_as_one_file(cache):
    header, content = handlers.handle_file(cache, make_request(kind="stl"))
    assert header["name"] == "knee_stl.zip"
    assert "knee-femur.stl" in zipfile.ZipFile(BytesIO(content)).namelist()
    assert handlers.handle_file(cache, make_request(kind="glb"))[1][:4] == b"glTF"


def test_the_python_snippet_reproduces_the_image(cache):
    knee = Knee(
        osteophytes=(Osteophyte(site="medial_tibia", size_mm=2.0),),
        cysts=(Cyst(site="medial_tibia", diameter_mm=4.0),),
        shape=(0.5, -1.0),
        texture_seed=2**62 + 1,
        grade=2,
    )
    lines = format_python_lines(knee, make_small_protocol(mono_kev=55.0), 2**53 + 7, "linear")
    assert len(lines.splitlines()) == 3
    names = {}
    exec(lines, names)
    made = cache.simulate_image(knee, make_small_protocol(mono_kev=55.0), 2**53 + 7)
    assert (names["radiograph"].pixels == made.image.pixels).all()


# --- fields and presets of the page ---


@pytest.mark.parametrize(("kind", "of"), [("knee", Knee), ("protocol", pssf.Protocol)])
def test_every_field_is_on_the_page_once_or_listed_as_hidden(kind, of):
    groups = getattr(load_page_settings(), kind)
    visible = [name for group in groups for name in group.fields]
    assert sorted([*visible, *load_page_settings().hidden_fields[kind]]) == sorted(
        one.name for one in dataclasses.fields(of)
    )
    specs = load_field_specs(kind)
    listed = {field["name"]: field for group in build_listing()[kind] for field in group["fields"]}
    assert all(
        listed[name]["what"] == specs[name].description
        and listed[name]["label"] == specs[name].label
        and listed[name]["unit"] == specs[name].unit
        for name in visible
    )
    labels = [one.label for one in specs.values()]
    assert len(set(labels)) == len(labels)


def test_the_server_accepts_every_preset_and_protocol_of_the_page():
    page = json.loads(json.dumps(build_listing()))
    for preset in page["presets"].values():
        make_request(knee=preset["knee"], protocol=page["protocols"][preset["protocol"]])
    for protocol in page["protocols"].values():
        make_request(protocol=protocol)
    assert "bilateral" not in page["protocols"]


def test_a_large_seed_is_not_rounded_by_the_browser():
    knee = Knee(texture_seed=2**63 - 1)
    assert make_request(knee=json.loads(json.dumps(knee_to_page_dict(knee)))).knee == knee


# --- the server ---


class Site:
    """Run a server and send requests to it."""

    def __init__(self, process, link):
        self.process, self.link = process, link
        self.port, self.token = int(link.split(":")[2].split("/")[0]), link.split("/")[3]

    def call(self, method, path, body=None, headers=None, base=None):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=300)
        content = body if isinstance(body, bytes | None) else json.dumps(body).encode()
        given = {"Content-Type": "application/json"} if content is not None else {}
        connection.request(method, f"/{base or self.token}/{path}", content, {**given, **(headers or {})})
        answer = connection.getresponse()
        return answer, answer.read()

    def request_radiograph(self, **changes):
        answer, content = self.call("POST", "answer/radiograph", make_state(**changes))
        assert answer.status == 200, content
        length = int.from_bytes(content[:4], "little")
        header = json.loads(content[4 : 4 + length])
        return header, np.frombuffer(content[4 + length :], "<u2").reshape(header["rows"], header["cols"])


@pytest.fixture(scope="module")
def site():
    process = subprocess.Popen(
        [sys.executable, "-m", "pssf", "explore", "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield Site(process, process.stdout.readline().strip())
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert errors == ""


def test_served_pixels_equal_those_of_simulate(site):
    header, pixels = site.request_radiograph(seed=7)
    assert header["whole"]
    assert (pixels == pssf.simulate(Knee(), make_small_protocol(), rng=7, engine=ENGINE).pixels).all()
    coarse, _ = site.request_radiograph(side=32)
    assert (coarse["rows"], coarse["whole"], coarse["truth"]) == (32, False, None)
    assert site.request_radiograph(seed=8)[0]["rays_traced"] == 0


def test_every_response_has_restrictive_security_headers(site):
    for path in ("", "page/app.js", "page/style.css", "fields", "nothing"):
        answer, _ = site.call("GET", path)
        policy = answer.getheader("Content-Security-Policy")
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert answer.getheader("X-Content-Type-Options") == "nosniff"
        assert answer.getheader("Referrer-Policy") == "no-referrer"


def test_the_page_has_no_external_links_and_no_inline_code(site):
    _, page = site.call("GET", "")
    text = page.decode()
    assert "<style" not in text
    assert " style=" not in text
    assert " onclick" not in text
    assert text.count("<script") == text.count('<script type="module" src="page/app.js">') == 1
    assert "://" not in text


STATE = json.dumps(make_state()).encode()
HOSTILE = {
    "another token": (("GET", "", None, {}), {"base": "x" * 32}, 403, "token must be"),
    "no token": (("GET", "", None, {}), {"base": "fields"}, 403, "token must be"),
    "another host": (("GET", "", None, {"Host": "evil.example:80"}), {}, 403, "got 'evil.example:80'"),
    "another origin": (("POST", "draw", STATE, {"Origin": "http://evil.example"}), {}, 403, "the explore page, got 'http://evil"),
    "a null origin": (("POST", "draw", STATE, {"Origin": "null"}), {}, 403, "the explore page, got 'null'"),
    "another site": (("POST", "draw", STATE, {"Sec-Fetch-Site": "same-site"}), {}, 403, "same-origin, got 'same-site'"),
    "no JSON": (("POST", "answer/radiograph", b"{", {}), {}, 400, "got 1 bytes"),
    "not UTF-8": (("POST", "answer/radiograph", b'{"tab": "\xff"}', {}), {}, 400, "request must be JSON"),
    "nested": (("POST", "answer/radiograph", b"[" * 60_000, {}), {}, 400, "got 60000 bytes"),
    "a list": (("POST", "answer/radiograph", b"[]", {}), {}, 400, "Expected `object`"),
    "unknown entry": (("POST", "draw", b'{"grade": 1, "grade_table": "paper", "seed": 1, "x": 1}', {}), {}, 400, "`x`"),
    "another type": (("POST", "draw", b"a=1", {"Content-Type": "text/plain"}), {}, 400, "json, got 'text/plain'"),
    "too large": (("POST", "draw", b" " * (MAX_BODY_BYTES + 1), {}), {}, 413, f"at most {MAX_BODY_BYTES} bytes"),
    "a path": (("GET", "page/../../../etc/passwd", None, {}), {}, 404, "address"),
    "an encoded path": (("GET", "page/..%2f..%2fserver.py", None, {}), {}, 404, "address"),
    "unknown answer": (("POST", "answer/file", STATE, {}), {}, 404, "address"),
    "another method": (("DELETE", "fields", None, {}), {}, 405, "method"),
    "a table that is a path": (
        ("POST", "draw", b'{"grade": 1, "grade_table": "/etc/x.toml", "seed": 1}', {}), {}, 400,
        "got '/etc/x.toml'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_or_malformed_requests_get_a_one_line_error(what, site):
    (method, path, body, headers), more, status, message = HOSTILE[what]
    answer, content = site.call(method, path, body, headers, **more)
    assert answer.status == status
    response = json.loads(content)
    assert list(response) == ["error"]
    assert message in response["error"]
    assert "allowed: " in response["error"] or " must be " in response["error"]
    assert len(response["error"].splitlines()) == 1
    assert site.token not in content.decode()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"knee": {"varus_deg": 99}}, "varus_deg must be between -16 and 16 deg, got 99 deg"),
        ({"knee": {"varus": 1}}, ", got 'varus'"),
        ({"knee": {"osteophytes": [3]}}, "osteophytes must be a list of tables"),
        ({"protocol": {**protocol_to_dict(make_small_protocol()), "rows": 8192}}, ", got 8192 pixels"),
        (
            {"protocol": protocol_to_dict(make_small_protocol()) | {"knee_distance_mm": 210.0}},
            "must be 0 mm on the page, got 210 mm",
        ),
        ({"protocol": {}}, "; 'name' is missing"),
        ({"seed": -1}, ", got -1"),
        ({"seed": "1e9"}, ", got '1e9'"),
        ({"processing": "xray"}, "processing"),
        ({"side": 7}, ", got 7 pixels"),
        ({"tab": ""}, "tab must have 1 to 64 characters, got ''"),
    ],
)
def test_an_invalid_value_is_named_in_the_error_response(changes, message, site):
    answer, content = site.call("POST", "answer/radiograph", make_state(**changes))
    assert answer.status == 400
    assert message in json.loads(content)["error"]


def test_the_worker_continues_after_a_knee_that_cannot_be_built(site):
    crowded = [{"site": "medial_tibia", "size_mm": 2.0, "place": place} for place in (0.0, 0.1)]
    answer, content = site.call("POST", "answer/radiograph", make_state(knee={"osteophytes": crowded}))
    assert answer.status == 400
    assert "osteophytes at medial_tibia" in json.loads(content)["error"]
    assert site.request_radiograph()[0]["whole"]


def test_a_chunked_request_body_is_limited_in_size(site):
    with socket.create_connection(("127.0.0.1", site.port), timeout=60) as raw:
        head = f"POST /{site.token}/draw HTTP/1.1\r\nHost: 127.0.0.1:{site.port}\r\nContent-Type: application/json\r\n"
        raw.sendall((head + "Transfer-Encoding: chunked\r\nConnection: close\r\n\r\n").encode())
        # The server may close the connection before the entire body is sent.
        with suppress(OSError):
            for _ in range(70):
                raw.sendall(b"400\r\n" + b" " * 1024 + b"\r\n")
        answer = raw.recv(4096).decode()
    assert " 413 " in answer.splitlines()[0]


def test_the_server_listens_only_on_localhost():
    with _bind_socket(0) as bound:
        assert bound.getsockname()[0] == "127.0.0.1"


def test_a_killed_worker_is_restarted(site):
    before = site.request_radiograph()[0]["process"]
    os.kill(before, signal.SIGKILL)
    header, pixels = site.request_radiograph(seed=9)
    assert header["rays_traced"] > 0
    assert (pixels == pssf.simulate(Knee(), make_small_protocol(), rng=9, engine=ENGINE).pixels).all()
    assert header["process"] != before


def test_a_new_request_supersedes_older_ones_of_the_same_tab_only(site):
    found = {}

    def ask(name, **changes):
        found[name] = site.call("POST", "answer/radiograph", make_state(**changes))[0].status

    threads = []
    for number in range(5):
        knee = knee_to_page_dict(Knee(jsw_medial_mm=3.0 + 0.1 * number))
        threads.append(threading.Thread(target=ask, args=(number,), kwargs={"knee": knee, "tab": "one"}))
    threads.append(threading.Thread(target=ask, args=("other",), kwargs={"tab": "two"}))
    for thread in threads:
        thread.start()
        time.sleep(0.15)
    for thread in threads:
        thread.join()
    assert found[4] == found["other"] == 200
    assert [found[number] for number in range(1, 4)] == [409, 409, 409]


def test_an_occupied_port_gives_a_one_line_error(site):
    command = [sys.executable, "-m", "pssf", "explore", "--no-browser", "--port", str(site.port)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"pssf: port must be free, got {site.port} (")
    assert len(done.stderr.splitlines()) == 1


def test_the_error_for_a_missing_extra_names_its_packages(monkeypatch):
    from pssf import explore

    monkeypatch.setattr(explore, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"explore requires starlette, uvicorn, not installed"):
        explore.require_extra()


def test_spectra_are_prefetched_outwards_from_the_protocol_voltage(monkeypatch):
    beams = []
    monkeypatch.setattr(prefetch.os, "nice", lambda by: None)
    monkeypatch.setattr(prefetch.signal, "signal", lambda *given: None)
    monkeypatch.setattr("pssf.xray.spectrum.tube_spectrum", lambda *beam: beams.append(beam))
    prefetch.compute_spectra("reference")
    assert beams[0] == (70.0, 12.0, 3.0)
    assert sorted(kv for kv, _, _ in beams) == list(range(40, 121))


def test_closing_a_worker_ends_waiting_requests_and_rejects_new_ones():
    worker = Worker()
    with ThreadPoolExecutor(1) as executor:
        waiting = executor.submit(worker.ask, "radiograph", make_request())
        while worker.pid is None:
            time.sleep(0.01)
        worker.close()
        with pytest.raises((SupersededError, WorkersLostError)):
            waiting.result()
    assert worker.pid is None
    with pytest.raises(WorkersLostError, match="closed"):
        worker.ask("radiograph", make_request())
