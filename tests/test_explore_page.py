"""Check the page of `pssf explore` in Chromium: controls, image, overlays and export."""

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
from tools.browser import CHROMIUM_FLAGS, find_chromium

import pssf
from pssf.data.imaging.explore_table import load_page_settings
from pssf.explore.stage_cache import ENGINE

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = find_chromium()
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed (apt-get install chromium)")
SIDE = 96
WAIT_MS = 240_000
# The script exposes the page's modules, but not those in the frame of the 3D view. It runs at load time because the
# browser sometimes discards an `import` that only a test awaits.
MODULES = """addEventListener("load", () => {
  for (const name of window === window.top && document.querySelector("#film") ? ["app", "server"] : [])
    import(new URL(`page/${name}.js`, document.baseURI).href).then((module) => { window[name] = module; });
})"""
# The 3D view draws no triangle, because rendering without a graphics card takes a minute; test_knee_viewer renders it.
NO_DRAWING = "WebGL2RenderingContext.prototype.drawElements = WebGL2RenderingContext.prototype.drawArrays = () => {}"
# Coarse detector with an unchanged field of view, for fast images.
SMALL = {"rows": SIDE, "cols": SIDE, "pixel_mm": 3.2}


def make_fragment(**changes):
    content = {"from": "reference", "knee": {}, "protocol": SMALL, "seed": 0, "processing": "linear", **changes}
    return "#" + json.dumps(content)


def simulate_expected(knee=None, seed=0, **changes):
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
def open_page(browser, link, where=None):
    """Open the page in a new context and require an empty console."""
    context = browser.new_context(viewport={"width": 1500, "height": 900})
    context.add_init_script(MODULES)
    context.add_init_script(NO_DRAWING)
    page, messages = context.new_page(), []
    page.set_default_timeout(WAIT_MS)
    # The browser logs each error response, which some tests cause on purpose, and that WebGL without a graphics card
    # is slow.
    expected = ("status of 4", "GL Driver Message")
    page.on(
        "console",
        lambda message: None if any(text in message.text for text in expected) else messages.append(message.text),
    )
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.goto(link + (where or make_fragment()))
    page.wait_for_selector("html[data-picture$=whole]")
    page.wait_for_function("window.app && window.server")
    yield page
    context.close()
    assert messages == []


@pytest.fixture(scope="module")
def tab(browser, server):
    with open_page(browser, server[1]) as page:
        # The 3D view is closed, because WebGL without a graphics card is slow.
        page.click("#solids-open > summary")
        yield page


@pytest.fixture
def page(tab):
    """Reset the page to its initial state with the small detector."""
    script = """text => {
      history.replaceState(null, "", text);
      window.dispatchEvent(new HashChangeEvent("hashchange"));
    }"""
    act(tab, lambda: tab.evaluate(script, make_fragment()))
    return tab


def count_pictures(page):
    return int(page.evaluate("document.documentElement.dataset.picture").split()[0])


def act(page, action):
    """Perform an action and wait for the full-resolution image that follows."""
    before = count_pictures(page)
    action()
    script = """before => {
      const [count, kind] = document.documentElement.dataset.picture.split(" ");
      return +count > before && kind === "whole";
    }"""
    page.wait_for_function(script, arg=before)


def read_state(page):
    """Return the current state of the page."""
    return page.evaluate("app.store.now")


def read_pixels(page):
    """Return the (rows, cols) pixels of the page."""
    # The bytes are transferred as text, because transferring four million numbers as a list takes almost a minute.
    rows, cols, data = page.evaluate("""async () => {
      const { header, pixels } = app.film.present;
      const file = new FileReader();
      const read = new Promise((done) => { file.onload = () => done(file.result); });
      file.readAsDataURL(new Blob([pixels]));
      return [header.rows, header.cols, await read];
    }""")
    return np.frombuffer(base64.b64decode(data.split(",")[1]), "<u2").reshape(rows, cols)


def read_canvas(page):
    """Return the (rows, cols, 3) pixels of the canvas."""
    data = page.evaluate("document.querySelector('#film').toDataURL('image/png')")
    with Image.open(BytesIO(base64.b64decode(data.split(",")[1]))) as image:
        return np.asarray(image.convert("RGB"))


def open_groups(page):
    page.evaluate("document.querySelectorAll('details.group').forEach((box) => { box.open = true; })")


def set_number(page, name, value, part="#knee"):
    """Open all groups and set the number of a field."""
    open_groups(page)
    box = page.locator(f"{part} [data-field='{name}'] input[type=number]").first
    box.fill(str(value))
    box.dispatch_event("change")


def test_page_pixels_and_python_snippet_agree_with_simulate(page):
    act(page, lambda: set_number(page, "tube_kv", 81, "#exposure"))
    assert (read_pixels(page) == simulate_expected(tube_kv=81.0)).all()
    page.wait_for_function("() => document.querySelector('#lines').textContent.includes('tube_kv=81')")
    names = {}
    exec(page.inner_text("#lines"), names)
    assert (names["radiograph"].pixels == read_pixels(page)).all()


def test_every_control_changes_its_own_field_only(browser, server):
    context = browser.new_context()
    context.add_init_script(MODULES)
    context.add_init_script(NO_DRAWING)
    page = context.new_page()
    page.goto(server[1] + make_fragment())
    page.wait_for_selector("html[data-picture]", timeout=WAIT_MS)
    page.wait_for_function("window.app")
    # The server is replaced by an error response, so that no image is simulated after each change.
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


def test_every_control_has_an_accessible_name(page):
    open_groups(page)
    act(page, lambda: page.click("text=Add to osteophytes"))
    nameless = page.evaluate("""() => [...document.querySelectorAll("input, select, button, canvas[role], iframe")]
      .filter((node) => !(node.labels?.length || node.ariaLabel || node.title || node.textContent.trim()))
      .map((node) => node.outerHTML)""")
    assert nameless == []
    described = page.evaluate("""() => [...document.querySelectorAll("[aria-describedby]")]
      .filter((node) => !document.getElementById(node.getAttribute("aria-describedby"))).length""")
    assert described == 0


def test_window_and_level_are_exact_to_the_pixel_value(page):
    pixels = read_pixels(page).astype(float)
    for width, level, invert in ((1000, 3000, True), (12345, 9876, False), (1, 5000, False)):
        for name, value in (("window", width), ("level", level)):
            page.fill(f"#{name}", str(value))
            page.dispatch_event(f"#{name}", "change")
        page.set_checked("#bone-bright", invert)
        fraction = np.clip((pixels - (level - width / 2)) / width, 0, 1)
        grey = np.floor(255 * (1 - fraction if invert else fraction) + 0.5)
        assert (read_canvas(page) == grey[..., None]).all()


def test_a_mouse_drag_changes_window_and_level(page):
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


def test_dragging_a_slider_is_one_undo_step(page):
    script = """(value, kind) => {
      const slider = document.querySelector("[data-field='jsw_medial_mm'] input[type=range]");
      slider.value = value;
      slider.dispatchEvent(new Event(kind));
    }"""
    for value in (4.5, 4.2, 4.0):
        page.evaluate(f"([v, k]) => ({script})(v, k)", [value, "input"])
    act(page, lambda: page.evaluate(f"([v, k]) => ({script})(v, k)", [4.0, "change"]))
    assert (read_pixels(page) == simulate_expected(pssf.Knee(jsw_medial_mm=4.0))).all()
    act(page, lambda: page.click("#undo"))
    assert read_state(page)["knee"]["jsw_medial_mm"] == 5.0
    assert (read_pixels(page) == simulate_expected()).all()
    act(page, lambda: page.click("#redo"))
    assert read_state(page)["knee"]["jsw_medial_mm"] == 4.0
    page.click("#undo")


def test_a_reload_restores_the_state(browser, server):
    with open_page(browser, server[1], make_fragment(knee={"varus_deg": 3.0}, seed=5, processing="processed")) as page:
        before = read_pixels(page)
        state = read_state(page)
        page.reload()
        page.wait_for_selector("html[data-picture$=whole]")
        assert read_state(page) == state
        assert (state["knee"]["varus_deg"], state["seed"], state["processing"]) == (3.0, 5, "processed")
        assert (read_pixels(page) == before).all()


def test_two_tabs_do_not_disturb_each_other(browser, server, page):
    with open_page(browser, server[1], make_fragment(seed=3)) as other:
        act(page, lambda: set_number(page, "mas", 4, "#exposure"))
        act(other, lambda: set_number(other, "mas", 1, "#exposure"))
        assert (read_pixels(page) == simulate_expected(mas=4.0)).all()
        assert (read_pixels(other) == simulate_expected(seed=3, mas=1.0)).all()
        assert read_state(page)["seed"] == 0


def test_the_page_recovers_after_the_worker_is_killed(page):
    process = "app.film.present.header.process"
    before = page.evaluate(process)
    os.kill(before, signal.SIGKILL)
    act(page, lambda: page.click("#another"))
    assert (read_pixels(page) == simulate_expected(seed=1)).all()
    assert page.evaluate(process) != before
    assert page.is_hidden("#error")


def test_an_error_is_shown_as_an_alert_until_it_is_corrected(page):
    open_groups(page)
    act(page, lambda: set_number(page, "sod_mm", 1100, "#exposure"))
    with page.expect_response(lambda answer: answer.status == 400):
        set_number(page, "sdd_mm", 1000, "#exposure")
    page.wait_for_selector("#error:not([hidden])")
    assert page.get_attribute("#error", "role") == "alert"
    page.wait_for_selector("#busy:text-is('This image is out of date')")
    assert page.get_attribute("#viewport", "aria-busy") == "false"
    assert "sod_mm must be less than sdd_mm = 1000.0 mm, got 1100.0 mm" in page.inner_text("#error")
    act(page, lambda: page.click("#undo"))
    assert page.is_hidden("#error")


def test_an_unfinished_response_is_discarded_after_a_new_request(page):
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


def test_presets_protocols_and_sampled_knees_change_the_state(page):
    act(page, lambda: page.select_option("#draw-table", "population") and page.click("#draw"))
    state = read_state(page)
    assert (state["knee"]["grade"], state["knee"]["jsw_definition"], len(state["knee"]["texture_seed"]) > 15) == (
        0,
        "read",
        True,
    )
    page.click("#undo")
    page.select_option("#preset", "healthy, lateral view")
    assert read_state(page)["protocol"]["projection"] == "ML"
    page.select_option("#protocol-name", "low_dose")
    assert read_state(page)["protocol"]["mas"] == pssf.load_protocol("low_dose").mas
    page.click("#reset")
    assert read_state(page)["from"] == "reference"


def test_the_page_starts_with_processed_display_and_bright_bone(browser, server):
    fields = {"from": "reference", "knee": {}, "protocol": SMALL}
    with open_page(browser, server[1], "#" + json.dumps(fields)) as page:
        assert read_state(page)["processing"] == page.input_value("#processing") == "processed"
        assert page.is_checked("#bone-bright")
        protocol = dataclasses.replace(pssf.load_protocol("reference"), **SMALL)
        radiograph = pssf.simulate(pssf.Knee(), protocol, rng=0, engine=ENGINE)
        assert (read_pixels(page) == pssf.render_for_display(radiograph, bits=16, processing="processed")).all()
        page.wait_for_function("() => document.querySelector('#lines').textContent.includes('render_for_display')")
        names = {}
        exec(page.inner_text("#lines"), names)
        assert (names["image"] == read_pixels(page)).all()
        bright, dark = (
            read_canvas(page)[..., 0][where].mean()
            for where in (read_pixels(page) > 40_000, read_pixels(page) < 20_000)
        )
        assert bright > dark
        page.uncheck("#bone-bright")
        bright, dark = (
            read_canvas(page)[..., 0][where].mean()
            for where in (read_pixels(page) > 40_000, read_pixels(page) < 20_000)
        )
        assert bright < dark


def test_a_busy_sign_is_shown_while_image_and_parameters_differ(page):
    script = """delay => {
      const real = window.fetch, sign = document.querySelector("#busy"), seen = [];
      window.seen = seen;
      new MutationObserver(() => seen.push(sign.textContent)).observe(sign, { childList: true });
      window.fetch = async (...given) => {
        if (given[0] === "answer/radiograph") await new Promise((done) => setTimeout(done, delay));
        return real(...given);
      };
      window.restore = () => { window.fetch = real; };
    }"""
    page.evaluate(script, 600)
    page.click("#another")
    assert page.get_attribute("#viewport", "aria-busy") == "true"
    page.wait_for_selector("#busy:text-is('Simulating …')")
    page.wait_for_selector("#viewport[aria-busy=false]")
    page.wait_for_selector("#busy:empty", state="attached")
    assert (read_pixels(page) == simulate_expected(seed=1)).all()
    page.evaluate("restore()")
    assert [page.get_attribute("#busy", name) for name in ("role", "aria-live")] == ["status", "polite"]
    # A status that is hidden again within 150 ms does not appear at all.
    assert (
        page.evaluate("""async () => {
      const { showBusy } = await import(new URL("page/busy.js", document.baseURI).href);
      const wait = (ms) => new Promise((done) => setTimeout(done, ms));
      seen.length = 0;
      showBusy("short", true);
      await wait(60);
      showBusy("", false);
      await wait(300);
      return seen.length;
    }""")
        == 0
    )


def test_a_status_reports_that_a_preview_awaits_full_resolution(page):
    script = """rows => {
      const sign = document.querySelector("#busy");
      window.seen = [];
      new MutationObserver(() => seen.push(sign.textContent)).observe(sign, { childList: true });
      const { store } = app;
      store.change({ protocol: { ...store.now.protocol, rows, cols: rows, pixel_mm: 307.2 / rows } }, true);
    }"""
    act(page, lambda: page.evaluate(script, 1536))
    page.wait_for_selector("#busy:empty", state="attached")
    assert "Preview: simulating full resolution …" in page.evaluate("seen")


def compute_contrast(one, other):
    """Compute the contrast ratio of two colours (WCAG 2)."""

    def luminance(colour):
        parts = np.array(colour[:3]) / 255
        return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)

    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_the_histogram_is_visible_in_light_and_dark_mode(page):
    script = """() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done([
      document.querySelector("#histogram").toDataURL("image/png"),
      getComputedStyle(document.querySelector("#radiograph")).backgroundColor.match(/[0-9]+/g).map(Number),
    ]))))"""
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        # The browser applies the change of the colour scheme with the next frame.
        data, panel = page.evaluate(script)
        with Image.open(BytesIO(base64.b64decode(data.split(",")[1]))) as image:
            last_row = np.asarray(image.convert("RGBA"))[-1]
        bars = last_row[last_row[:, 3] == 255]
        assert len(bars) > 100
        assert min(compute_contrast(one, panel) for one in bars) > 4.5


def test_the_difference_to_a_pinned_image_is_shown(page):
    page.click("#pin")
    page.select_option("#compare", "difference")
    page.fill("#window", "2000")
    page.dispatch_event("#window", "change")
    grey = read_canvas(page)
    assert (grey == 32).all()
    first = read_pixels(page).astype(int)
    act(page, lambda: page.click("#another"))
    differs = read_pixels(page).astype(int) - first
    displayed = read_canvas(page).astype(int)
    orange, blue = displayed[differs > 100], displayed[differs < -100]
    assert (orange[:, 0] > orange[:, 2]).all()
    assert (blue[:, 2] > blue[:, 0]).all()
    page.select_option("#compare", "a")
    assert read_pixels(page).shape == first.shape
    page.select_option("#compare", "b")


def test_a_new_protocol_resets_the_window_but_a_slider_does_not(page):
    window = "() => [+document.querySelector('#window').value, +document.querySelector('#level').value]"
    page.click("#auto")
    first = page.evaluate(window)
    act(page, lambda: set_number(page, "mas", 4, "#exposure"))
    assert page.evaluate(window) == first
    act(page, lambda: page.select_option("#protocol-name", "low_dose"))
    low, high = np.quantile(read_pixels(page), [0.005, 0.4])
    width, level = page.evaluate(window)
    assert width < 0.6 * first[0]
    assert low - 0.1 * width < level < high + 0.5 * width
    assert 64 < read_canvas(page)[..., 0][read_pixels(page) < high].mean() < 192
    act(page, lambda: page.click("#reset"))
    # The processed display, which is the initial display of the page, has a separate window setting.
    assert page.input_value("#processing") == "processed"
    act(page, lambda: page.select_option("#processing", "linear"))
    assert page.evaluate(window) == pytest.approx(first, rel=0.1)


def test_the_page_lists_differences_between_current_and_pinned_image(page):
    page.click("#pin")
    assert page.inner_text("#compared") == "Both images have the same parameters."
    act(page, lambda: set_number(page, "mas", 4, "#exposure"))
    assert page.inner_text("#compared") == "The current image differs from the pinned image in current-time product."
    page.select_option("#compare", "difference")
    assert "larger (orange), smaller (blue)" in page.inner_text("#compared")
    page.select_option("#compare", "b")


def test_the_legend_names_the_mask_colours(page):
    page.set_checked("#show-masks", True)
    page.wait_for_selector("#legend span")
    named = page.evaluate("[...document.querySelectorAll('#legend span')].map((one) => one.textContent)")
    assert named == ["femur", "tibia", "fibula", "patella"]
    colour = page.evaluate("getComputedStyle(document.querySelector('#legend span'), '::before').backgroundColor")
    assert colour == "rgb(230, 159, 0)"
    page.set_checked("#show-masks", False)
    page.wait_for_selector("#legend", state="hidden")


def test_overlays_match_the_landmarks_of_the_truth(page):
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
    for name, point_px in truth.landmarks_px.items():
        assert marks[name] == pytest.approx(point_px, abs=1e-6)
    assert page.locator("#overlay [data-space]").count() == 2
    page.set_checked("#show-masks", True)
    page.wait_for_function("() => document.documentElement.dataset.masks === 'femur tibia fibula patella'")
    page.set_checked("#show-masks", False)


def test_measured_distances_are_in_mm_at_the_joint_plane(page):
    page.focus("#viewport")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("m")
    for _ in range(2):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("m")
    page.wait_for_selector("#measured")
    # A screen reader announces the distance without another key.
    assert f"distance {page.text_content('#measured')}" in page.inner_text("#cursor")
    magnification = 1150 / 950
    assert page.text_content("#measured") == f"{20 * 3.2 / magnification:.2f} mm"


def test_pixel_value_and_path_lengths_at_the_cursor_are_shown(page):
    page.focus("#viewport")
    page.keyboard.press("ArrowDown")
    page.wait_for_function("() => document.querySelector('#cursor').textContent.includes('muscle')")
    text = page.inner_text("#cursor")
    row, col = (int(part) for part in text.replace("Row ", "").replace(" column ", "").split(":")[0].split(","))
    assert f": {read_pixels(page)[row, col]};" in text
    paths = pssf.trace(
        pssf.build(pssf.Knee()).scene, dataclasses.replace(pssf.load_protocol("reference"), **SMALL), engine=ENGINE
    )
    assert f"muscle {paths.path_mm['muscle'][row, col]:.2f} mm" in text


def test_a_downloaded_file_contains_the_displayed_pixels(page, tmp_path):
    with page.expect_download() as given:
        page.click("[data-kind=tif]")
    given.value.save_as(tmp_path / "mine.tif")
    assert (pssf.load(tmp_path / "mine.tif").pixels == read_pixels(page)).all()


def test_the_skip_link_is_first_and_leads_to_the_radiograph(page):
    page.evaluate("document.activeElement.blur()")
    page.focus("#skip")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "viewport"
    first = page.evaluate("document.querySelector('button, input, select, a, [tabindex]').id")
    assert first == "skip"


def test_a_narrow_window_needs_no_horizontal_scrolling(page):
    page.set_viewport_size({"width": 380, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 380
    # The radiograph stays visible above the slider.
    page.locator("[data-field=jsw_lateral_mm]").scroll_into_view_if_needed()
    box = page.locator("#viewport").bounding_box()
    assert box["y"] >= 0
    assert box["y"] + box["height"] < page.locator("[data-field=jsw_lateral_mm]").bounding_box()["y"]
    page.set_viewport_size({"width": 1500, "height": 900})


def test_the_3d_view_keeps_its_camera_after_a_change(page):
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
