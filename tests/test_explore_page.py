"""The page of `pssf explore` in a real browser: every control does what it says."""

import base64
import dataclasses
import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import pssf
from pssf.data.imaging.explore_table import load_page_settings
from pssf.explore.browser import CHROMIUM_FLAGS, find_chromium
from pssf.explore.stage_cache import ENGINE

sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright, which drives the browser")
CHROMIUM = find_chromium()
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium (apt-get install chromium)")
SIDE = 96
WAIT_MS = 240_000
# The page's own modules, as the page has loaded them, and not in the frame of its solids. A promise of `import` that
# none but a test waits for is now and then collected before it is kept.
MODULES = """addEventListener("load", () => {
  for (const name of window === window.top && document.querySelector("#film") ? ["app", "server"] : [])
    import(new URL(`page/${name}.js`, document.baseURI).href).then((module) => { window[name] = module; });
})"""
# A small detector of the same field, so that a picture takes a moment.
SMALL = {"rows": SIDE, "cols": SIDE, "pixel_mm": 3.2}


def fragment(**changes):
    content = {"from": "reference", "knee": {}, "protocol": SMALL, "seed": 0, "processing": "linear", **changes}
    return "#" + json.dumps(content)


def expected(knee=None, seed=0, **changes):
    protocol = dataclasses.replace(pssf.load_protocol("reference"), **{**SMALL, **changes})
    return pssf.simulate(knee or pssf.Knee(), protocol, rng=seed, engine=ENGINE).pixels


@pytest.fixture(scope="module")
def server():
    command = [sys.executable, "-m", "pssf", "explore", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    yield process, process.stdout.readline().strip()
    process.send_signal(signal.SIGINT)
    process.wait(timeout=60)


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        yield started
        started.close()


@contextmanager
def opened(browser, link, where=None):
    """A tab with the page; what it says on its console must be nothing."""
    context = browser.new_context(viewport={"width": 1500, "height": 900})
    context.add_init_script(MODULES)
    page, said = context.new_page(), []
    page.set_default_timeout(WAIT_MS)
    # The browser's own line for a refusal, which some tests ask for.
    page.on("console", lambda message: said.append(message.text) if "status of 4" not in message.text else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(link + (where or fragment()))
    page.wait_for_selector("html[data-picture$=whole]")
    page.wait_for_function("window.app && window.server")
    yield page
    context.close()
    assert said == []


@pytest.fixture(scope="module")
def tab(browser, server):
    with opened(browser, server[1]) as page:
        page.click("#solids-open > summary")  # closed: WebGL without a graphics card takes long
        yield page


@pytest.fixture
def page(tab):
    """The page as it starts, on the small detector."""
    script = """text => {
      history.replaceState(null, "", text);
      window.dispatchEvent(new HashChangeEvent("hashchange"));
    }"""
    act(tab, lambda: tab.evaluate(script, fragment()))
    return tab


def counted(page):
    return int(page.evaluate("document.documentElement.dataset.picture").split()[0])


def act(page, what):
    """Do something and wait for the whole picture that follows."""
    before = counted(page)
    what()
    script = """before => {
      const [count, kind] = document.documentElement.dataset.picture.split(" ");
      return +count > before && kind === "whole";
    }"""
    page.wait_for_function(script, arg=before)


def page_state(page):
    """The state as the page has it."""
    return page.evaluate("app.store.now")


def values(page):
    """(rows, cols)  pixels as the page has them"""
    # As text of their bytes: a list of four million numbers takes the browser's driver most of a minute.
    rows, cols, data = page.evaluate("""async () => {
      const { header, pixels } = app.film.present;
      const file = new FileReader();
      const read = new Promise((done) => { file.onload = () => done(file.result); });
      file.readAsDataURL(new Blob([pixels]));
      return [header.rows, header.cols, await read];
    }""")
    return np.frombuffer(base64.b64decode(data.split(",")[1]), "<u2").reshape(rows, cols)


def greys(page):
    """(rows, cols, 3)  of the canvas"""
    data = page.evaluate("document.querySelector('#film').toDataURL('image/png')")
    with Image.open(BytesIO(base64.b64decode(data.split(",")[1]))) as image:
        return np.asarray(image.convert("RGB"))


def open_groups(page):
    page.evaluate("document.querySelectorAll('details.group').forEach((box) => { box.open = true; })")


def set_number(page, name, value, part="#knee"):
    """Write into a field's box; its group is opened first."""
    open_groups(page)
    box = page.locator(f"{part} [data-field='{name}'] input[type=number]").first
    box.fill(str(value))
    box.dispatch_event("change")


def test_the_page_shows_the_pixels_of_simulate_and_the_lines_that_make_them(page):
    act(page, lambda: set_number(page, "tube_kv", 81, "#exposure"))
    assert (values(page) == expected(tube_kv=81.0)).all()
    page.wait_for_function("() => document.querySelector('#lines').textContent.includes('tube_kv=81')")
    names = {}
    exec(page.inner_text("#lines"), names)
    assert (names["radiograph"].pixels == values(page)).all()


def test_every_control_of_a_field_changes_the_field_that_it_names(browser, server):
    context = browser.new_context()
    context.add_init_script(MODULES)
    page = context.new_page()
    page.goto(server[1] + fragment())
    page.wait_for_selector("html[data-picture]", timeout=WAIT_MS)
    page.wait_for_function("window.app")
    # No picture is made of these.
    page.route("**/answer/**", lambda route: route.fulfill(status=409, json={"error": "superseded"}))
    changed = page.evaluate("""() => {
      const { store } = app, found = {}, places = { knee: "knee", protocol: "exposure" };
      const fields = Object.keys(places).flatMap((part) =>
        store.listing[part].flatMap((group) => group.fields.map((field) => [part, field])));
      for (const [part, field] of fields) {
        const box = document.querySelector(`#${places[part]} [data-field="${field.name}"]`);
        const open = box.querySelector("input[type=checkbox]");
        if (open && !open.checked) open.click();
        const before = store.now[part][field.name];
        const control = box.querySelector("select, input[type=range], input[type=text]");
        if (control.tagName === "SELECT") control.selectedIndex = (control.selectedIndex + 1) % control.options.length;
        else if (control.type === "range")
          control.value = +control.value < +control.max ? +control.value + +control.step : control.min;
        else control.value = field.named ? "mine" : "77";
        control.dispatchEvent(new Event("input"));
        control.dispatchEvent(new Event("change"));
        const now = store.now[part][field.name], was = store.before.at(-1)[part], text = JSON.stringify;
        const others = Object.keys(was).filter((name) =>
          name !== field.name && text(store.now[part][name]) !== text(was[name]));
        const link = store.read(location.hash)[part][field.name];
        found[`${part} ${field.name}`] = [now !== before, others, JSON.stringify(link) === JSON.stringify(now),
          box.querySelector("label").textContent.length > 0, box.querySelector(".hint").textContent.length > 5];
      }
      return found;
    }""")
    assert len(changed) == sum(
        len(group.fields) for group in (*load_page_settings().knee, *load_page_settings().protocol)
    )
    assert {name: facts for name, facts in changed.items() if facts != [True, [], True, True, True]} == {}
    context.close()


def test_every_control_has_a_name_that_a_screen_reader_says(page):
    open_groups(page)
    act(page, lambda: page.click("text=Add to osteophytes"))
    nameless = page.evaluate("""() => [...document.querySelectorAll("input, select, button, canvas[role], iframe")]
      .filter((node) => !(node.labels?.length || node.ariaLabel || node.title || node.textContent.trim()))
      .map((node) => node.outerHTML)""")
    assert nameless == []
    described = page.evaluate("""() => [...document.querySelectorAll("[aria-describedby]")]
      .filter((node) => !document.getElementById(node.getAttribute("aria-describedby"))).length""")
    assert described == 0


def test_window_and_level_are_right_to_the_pixel_value(page):
    pixels = values(page).astype(float)
    for width, level, invert in ((1000, 3000, True), (12345, 9876, False), (1, 5000, False)):
        for name, value in (("window", width), ("level", level)):
            page.fill(f"#{name}", str(value))
            page.dispatch_event(f"#{name}", "change")
        page.set_checked("#invert", invert)
        share = np.clip((pixels - (level - width / 2)) / width, 0, 1)
        grey = np.floor(255 * (1 - share if invert else share) + 0.5)
        assert (greys(page) == grey[..., None]).all()


def test_a_drag_moves_window_and_level_as_it_says(page):
    box = page.locator("#viewport").bounding_box()
    before = [int(page.input_value(f"#{name}")) for name in ("window", "level")]
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y - 20)
    page.mouse.up()
    after = [int(page.input_value(f"#{name}")) for name in ("window", "level")]
    step = max(1, before[0] / 300)
    assert after == pytest.approx([before[0] + 30 * step, before[1] - 20 * step], abs=1)


def test_a_slider_that_is_dragged_shows_pictures_on_the_way_and_is_one_step_to_undo(page):
    script = """(value, kind) => {
      const slider = document.querySelector("[data-field='jsw_medial_mm'] input[type=range]");
      slider.value = value;
      slider.dispatchEvent(new Event(kind));
    }"""
    for value in (4.5, 4.2, 4.0):
        page.evaluate(f"([v, k]) => ({script})(v, k)", [value, "input"])
    act(page, lambda: page.evaluate(f"([v, k]) => ({script})(v, k)", [4.0, "change"]))
    assert (values(page) == expected(pssf.Knee(jsw_medial_mm=4.0))).all()
    act(page, lambda: page.click("#undo"))
    assert page_state(page)["knee"]["jsw_medial_mm"] == 5.0
    assert (values(page) == expected()).all()
    act(page, lambda: page.click("#redo"))
    assert page_state(page)["knee"]["jsw_medial_mm"] == 4.0
    page.click("#undo")


def test_a_reload_restores_the_state(browser, server):
    with opened(browser, server[1], fragment(knee={"varus_deg": 3.0}, seed=5, processing="processed")) as page:
        before = values(page)
        state = page_state(page)
        page.reload()
        page.wait_for_selector("html[data-picture$=whole]")
        assert page_state(page) == state
        assert (state["knee"]["varus_deg"], state["seed"], state["processing"]) == (3.0, 5, "processed")
        assert (values(page) == before).all()


def test_two_tabs_do_not_disturb_each_other(browser, server, page):
    with opened(browser, server[1], fragment(seed=3)) as other:
        act(page, lambda: set_number(page, "mas", 4, "#exposure"))
        act(other, lambda: set_number(other, "mas", 1, "#exposure"))
        assert (values(page) == expected(mas=4.0)).all()
        assert (values(other) == expected(seed=3, mas=1.0)).all()
        assert page_state(page)["seed"] == 0


def test_after_the_worker_is_killed_the_next_picture_comes(page):
    process = "app.film.present.header.process"
    before = page.evaluate(process)
    os.kill(before, signal.SIGKILL)
    act(page, lambda: page.click("#another"))
    assert (values(page) == expected(seed=1)).all()
    assert page.evaluate(process) != before
    assert page.is_hidden("#error")


def test_a_refusal_is_told_where_it_is_read_out_and_goes_when_it_is_mended(page):
    open_groups(page)
    act(page, lambda: set_number(page, "sod_mm", 1100, "#exposure"))
    with page.expect_response(lambda answer: answer.status == 400):
        set_number(page, "sdd_mm", 1000, "#exposure")
    page.wait_for_selector("#error:not([hidden])")
    assert page.get_attribute("#error", "role") == "alert"
    page.wait_for_selector("#status:text-is('The image shown is out of date.')")
    assert "sod_mm must be less than sdd_mm = 1000.0 mm, got 1100.0 mm" in page.inner_text("#error")
    act(page, lambda: page.click("#undo"))
    assert page.is_hidden("#error")


def test_an_answer_that_is_still_coming_when_another_is_asked_for_is_dropped(page):
    script = """async () => {
      const { server } = window, real = window.fetch;
      let finish, headed;
      const begun = new Promise((resolve) => { headed = resolve; });
      window.fetch = async () => {
        setTimeout(headed);
        return new Response(new ReadableStream({ start: (control) => { finish = control; } }));
      };
      const said = server.probe({}).then(() => "shown", (error) => error instanceof server.Superseded);
      await begun;
      window.fetch = async () => new Response("{}", { status: 409 });
      await server.probe({}).catch(() => {});
      window.fetch = real;
      finish.enqueue(new Uint8Array([2, 0, 0, 0, 123, 125]));
      finish.close();
      return said;
    }"""
    assert page.evaluate(script) is True


def test_presets_protocols_and_drawn_knees_change_what_they_say(page):
    act(page, lambda: page.select_option("#draw-table", "population") and page.click("#draw"))
    state = page_state(page)
    assert (state["knee"]["grade"], state["knee"]["jsw_definition"], len(state["knee"]["texture_seed"]) > 15) == (
        0,
        "read",
        True,
    )
    page.click("#undo")
    page.select_option("#preset", "from the side")
    assert page_state(page)["protocol"]["projection"] == "ML"
    page.select_option("#protocol-name", "low_dose")
    assert page_state(page)["protocol"]["mas"] == pssf.load_protocol("low_dose").mas
    page.click("#reset")
    assert page_state(page)["from"] == "reference"


def test_the_difference_to_a_pinned_picture_is_shown(page):
    page.click("#pin")
    page.select_option("#compare", "difference")
    page.fill("#window", "2000")
    page.dispatch_event("#window", "change")
    grey = greys(page)
    assert (grey == 32).all()
    first = values(page).astype(int)
    act(page, lambda: page.click("#another"))
    differs = values(page).astype(int) - first
    shown = greys(page).astype(int)
    orange, blue = shown[differs > 100], shown[differs < -100]
    assert (orange[:, 0] > orange[:, 2]).all()
    assert (blue[:, 2] > blue[:, 0]).all()
    page.select_option("#compare", "a")
    assert values(page).shape == first.shape
    page.select_option("#compare", "b")


def test_another_technique_gets_a_window_of_its_own_and_a_slider_keeps_it(page):
    window = "() => [+document.querySelector('#window').value, +document.querySelector('#level').value]"
    page.click("#auto")
    first = page.evaluate(window)
    act(page, lambda: set_number(page, "mas", 4, "#exposure"))
    assert page.evaluate(window) == first
    act(page, lambda: page.select_option("#protocol-name", "low_dose"))
    low, high = np.quantile(values(page), [0.005, 0.4])
    width, level = page.evaluate(window)
    assert width < 0.6 * first[0]
    assert low - 0.1 * width < level < high + 0.5 * width
    assert 64 < greys(page)[..., 0][values(page) < high].mean() < 192
    act(page, lambda: page.click("#reset"))
    assert page.evaluate(window) == pytest.approx(first, rel=0.1)


def test_it_is_told_in_what_the_present_picture_differs_from_the_pinned_one(page):
    page.click("#pin")
    assert page.inner_text("#compared") == "Both images have the same parameters."
    act(page, lambda: set_number(page, "mas", 4, "#exposure"))
    assert page.inner_text("#compared") == "The current image differs from the pinned one in current-time product."
    page.select_option("#compare", "difference")
    assert "Orange: current larger" in page.inner_text("#compared")
    page.select_option("#compare", "b")


def test_the_colours_of_masks_are_told(page):
    page.set_checked("#show-masks", True)
    page.wait_for_selector("#legend span")
    named = page.evaluate("[...document.querySelectorAll('#legend span')].map((one) => one.textContent)")
    assert named == ["femur", "tibia", "fibula", "patella"]
    colour = page.evaluate("getComputedStyle(document.querySelector('#legend span'), '::before').backgroundColor")
    assert colour == "rgb(230, 159, 0)"
    page.set_checked("#show-masks", False)
    page.wait_for_selector("#legend", state="hidden")


def test_overlays_are_where_the_truth_is(page):
    page.set_checked("#show-landmarks", True)
    page.set_checked("#show-spaces", True)
    protocol = dataclasses.replace(pssf.load_protocol("reference"), **SMALL)
    truth = pssf.build(pssf.Knee()).truth(protocol)
    marks = page.evaluate("""() => {
      const { film } = app, { left, top, size } = film.box;
      const marks = [...document.querySelectorAll("#overlay circle.mark")];
      return Object.fromEntries(marks.map((mark) => [mark.dataset.landmark,
        [((+mark.getAttribute("cy") - top) / size[1]) * film.shown.header.rows - 0.5,
         ((+mark.getAttribute("cx") - left) / size[0]) * film.shown.header.cols - 0.5]]));
    }""")
    assert set(marks) == set(truth.landmarks_px)
    for name, place in truth.landmarks_px.items():
        assert marks[name] == pytest.approx(place, abs=1e-6)
    assert page.locator("#overlay [data-space]").count() == 2
    page.set_checked("#show-masks", True)
    page.wait_for_function("() => document.documentElement.dataset.masks === 'femur tibia fibula patella'")
    page.set_checked("#show-masks", False)


def test_the_measure_is_in_mm_at_the_joint_plane(page):
    page.focus("#viewport")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("m")
    for _ in range(2):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("m")
    page.wait_for_selector("#measured")
    # Where a screen reader says it, without another key.
    assert f"distance {page.text_content('#measured')}" in page.inner_text("#cursor")
    magnification = 1150 / 950
    assert page.text_content("#measured") == f"{20 * 3.2 / magnification:.2f} mm"


def test_value_and_paths_under_the_cursor_are_told(page):
    page.focus("#viewport")
    page.keyboard.press("ArrowDown")
    page.wait_for_function("() => document.querySelector('#cursor').textContent.includes('muscle')")
    text = page.inner_text("#cursor")
    row, col = (int(part) for part in text.replace("Row ", "").replace(" column ", "").split(":")[0].split(","))
    assert f": {values(page)[row, col]};" in text
    paths = pssf.trace(
        pssf.build(pssf.Knee()).scene, dataclasses.replace(pssf.load_protocol("reference"), **SMALL), engine=ENGINE
    )
    assert f"muscle {paths.path_mm['muscle'][row, col]:.2f} mm" in text


def test_a_file_is_handed_over(page, tmp_path):
    with page.expect_download() as given:
        page.click("[data-kind=tif]")
    given.value.save_as(tmp_path / "mine.tif")
    assert (pssf.load(tmp_path / "mine.tif").pixels == values(page)).all()


def test_the_first_tab_leads_to_the_radiograph(page):
    page.evaluate("document.activeElement.blur()")
    page.focus("#skip")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "viewport"
    first = page.evaluate("document.querySelector('button, input, select, a, [tabindex]').id")
    assert first == "skip"


def test_a_narrow_window_needs_no_scrolling_sideways(page):
    page.set_viewport_size({"width": 380, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 380
    # The radiograph stays in sight beside the slider that is moved.
    page.locator("[data-field=jsw_lateral_mm]").scroll_into_view_if_needed()
    box = page.locator("#viewport").bounding_box()
    assert box["y"] >= 0
    assert box["y"] + box["height"] < page.locator("[data-field=jsw_lateral_mm]").bounding_box()["y"]
    page.set_viewport_size({"width": 1500, "height": 900})


def test_the_solids_stand_with_beam_and_detector_and_keep_their_camera(page):
    turned = "() => document.querySelector('#solids-frame').contentWindow.location.hash.startsWith('#90,0,')"
    page.click("#solids-open > summary")
    frame = page.frame_locator("#solids-frame")
    frame.locator("text=Detector").first.wait_for()
    frame.locator("[data-turn='90 0']").click()
    page.wait_for_function(turned)
    before = page.evaluate("document.documentElement.dataset.solids")
    act(page, lambda: set_number(page, "varus_deg", 2))
    page.wait_for_function("before => document.documentElement.dataset.solids !== before", arg=before)
    page.wait_for_function(turned)
    page.click("#solids-open > summary")
