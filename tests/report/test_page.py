"""The report in a real browser: from disk, without a network, on a desk, a phone and paper."""

import base64
import json
import re
import time
from pathlib import Path
from typing import Any

import pytest
from found import HELD_OUT
from report_runs import discovered, explained, hostile_run, unexplained

from eoi_jax.report.svg import variables

DESK, PHONE = 1200, 390


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("runs")
    found = explained()
    return {
        "explained": discovered(root / "explained", found),
        "unexplained": discovered(root / "unexplained", unexplained(found)),
        "hostile": hostile_run(root / "hostile"),
    }


@pytest.fixture(params=["explained", "unexplained", "hostile"])
def any_run(request, folders: dict[str, Path]) -> Path:
    return folders[request.param]


def look(browser: Any, folder: Path, width: int = DESK, theme: str = "light") -> None:
    size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = [{"name": "prefers-color-scheme", "value": theme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    browser.get_log("browser")  # what others left there
    browser.get_log("performance")
    browser.get((folder / "report.html").as_uri())


def ask(browser: Any, expression: str) -> Any:
    return browser.execute_script(f"return {expression}")


def test_it_opens_from_disk_without_a_network_an_error_or_a_request(browser, any_run):
    look(browser, any_run)
    assert browser.get_log("browser") == []
    asked = [
        message["params"]["request"]["url"]
        for entry in browser.get_log("performance")
        if (message := json.loads(entry["message"])["message"])["method"]
        == "Network.requestWillBeSent"
    ]
    assert asked
    assert {url.split(":")[0] for url in asked} <= {"file", "data"}
    assert (any_run / "report.html").stat().st_size < 5e6


@pytest.mark.parametrize("width", [DESK, PHONE])
def test_every_figure_is_seen_within_the_page(browser, any_run, width):
    look(browser, any_run, width)
    boxes = ask(browser, "[...document.querySelectorAll('figure:not(.live) > svg, .uplot')].map("
                "one => { const box = one.getBoundingClientRect(); return [box.left, box.right, "
                "box.width, box.height]; })")  # fmt: skip
    assert len(boxes) >= 6
    for left, right, across, high in boxes:
        assert left >= 0
        assert right <= width
        assert across > 250
        assert high > 90
    paths = "[...document.querySelectorAll('figure > svg')].map(one => one.querySelectorAll('path')"
    assert min(ask(browser, f"{paths}.length)")) > 10  # those for paper too
    sizes = ask(
        browser,
        "[...document.querySelectorAll('figure:not(.live) svg text')].map(one => { const to = "
        "one.getScreenCTM(); return parseFloat(getComputedStyle(one).fontSize) * "
        "Math.hypot(to.a, to.b); })",
    )
    assert min(sizes) > (5.5 if width == PHONE else 8)  # [px]


@pytest.mark.parametrize("width", [DESK, PHONE])
def test_nothing_makes_the_page_scroll_sideways(browser, any_run, width):
    look(browser, any_run, width)
    assert ask(browser, "document.documentElement.scrollWidth") <= width
    out = ask(
        browser,
        "[...document.querySelectorAll('h1, h2, p, dd, li, figcaption, summary')].filter("
        "one => one.scrollWidth > one.clientWidth + 1).map(one => one.outerHTML)",
    )
    assert out == []


def test_the_answer_comes_first_and_what_was_added_is_marked_in_the_equation(browser, folders):
    look(browser, folders["explained"])
    summary = json.loads((folders["explained"] / "discovery.json").read_text())
    shown = ask(browser, "document.querySelector('h1').textContent")
    assert shown.replace("\u00a0", " ") == summary["answer"]
    added = ask(browser, "[...document.querySelectorAll('math .added')].map(one => [one.textContent"
                ", one.getBoundingClientRect().width, getComputedStyle(one).color])")  # fmt: skip
    assert len(added) == 2 * len(summary["added"])  # with names, and with values
    assert "coulomb_friction" in added[0][0]
    plain = ask(browser, "getComputedStyle(document.querySelector('math mtd')).color")
    assert all(width > 20 and colour != plain for _, width, colour in added)


def test_a_click_on_a_head_sorts_by_numbers_and_a_second_one_turns_it_round(browser, folders):
    look(browser, folders["explained"])
    column = "[...document.querySelectorAll('table')][0]"
    cells = f"[...{column}.tBodies[0].rows].map(row => row.cells[4].textContent)"
    for direction in ("ascending", "descending"):
        browser.execute_script(f"{column}.querySelectorAll('th button')[4].click()")
        values = [float(one) for one in ask(browser, cells)]
        assert values == sorted(values, reverse=direction == "descending")
        assert ask(browser, f"{column}.querySelectorAll('th')[4].ariaSort") == direction
    assert ask(browser, f"{column}.querySelectorAll('th[aria-sort=none]').length") == 6
    # From the keyboard: a head is a button.
    browser.execute_script(f"{column}.querySelector('th button').focus()")
    browser.switch_to.active_element.send_keys("\n")
    names = ask(browser, f"[...{column}.tBodies[0].rows].map(row => row.cells[0].textContent)")
    assert names == sorted(names)


def test_it_is_dark_where_the_reader_likes_it_dark_figures_too(browser, folders):
    seen = {}
    for theme in ("light", "dark"):
        look(browser, folders["explained"], theme=theme)
        seen[theme] = ask(
            browser,
            "[getComputedStyle(document.documentElement).backgroundColor, getComputedStyle("
            "document.querySelector('#effect svg [style*=\"fill: var(--s0)\"]')).fill]",
        )
        wanted = variables(theme == "dark")
        assert seen[theme] == [rgb(wanted["--page"]), rgb(wanted["--s0"])]
    assert seen["light"] != seen["dark"]


def rgb(colour: str) -> str:
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgb({', '.join(map(str, parts))})"


def test_it_prints_on_pages_of_a4_with_its_configuration(browser, folders):
    look(browser, folders["explained"], theme="dark")
    options = {"preferCSSPageSize": True, "printBackground": True}
    printed = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", options)["data"])
    assert printed.startswith(b"%PDF")
    pages = printed.count(b"/Type /Page\n")
    assert 2 <= pages <= 8
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed)
    a4 = [210 / 25.4 * 72, 297 / 25.4 * 72]  # [pt]
    assert boxes
    assert all([float(one) for one in box] == pytest.approx(a4, abs=1.0) for box in boxes)
    assert ask(browser, "document.querySelector('details').open")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": [
        {"name": "prefers-color-scheme", "value": "dark"}]})  # fmt: skip
    light = rgb(variables(dark=False)["--page"])
    assert ask(browser, "getComputedStyle(document.documentElement).backgroundColor") == light
    # Figures in place of charts.
    display = "[...document.querySelectorAll('{}')].map(one => getComputedStyle(one).display)"
    for part, wanted in (("figure > svg", "block"), (".chart, nav, .hint", "none")):
        assert set(ask(browser, display.format(part))) == {wanted}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_names_and_units_are_text_whatever_they_hold(browser, folders):
    look(browser, folders["hostile"])
    time.sleep(0.2)  # an image that fails to load says so a little later
    assert ask(browser, "typeof hacked") == "undefined"
    assert ask(browser, "[...document.scripts].map(one => one.type)") == ["application/json", ""]
    assert ask(browser, "document.querySelectorAll('img').length") == 0
    text = ask(browser, "document.body.textContent")
    for number in (1, 3, 4, 5, 6):
        assert f"<script>hacked={number}</script>" in text.replace("\u00a0", " ")
    assert '"><img src=x onerror="hacked=2">' in text.replace("\u00a0", " ")


def test_a_script_that_got_in_would_not_run(browser, folders, tmp_path):
    page = (folders["explained"] / "report.html").read_text()
    bad = "<script>hacked=1</script><img src=x onerror='hacked=1'><p onclick='hacked=1'>x</p>"
    (tmp_path / "report.html").write_text(page.replace("<main>", f"<main>{bad}"))
    look(browser, tmp_path)
    time.sleep(0.2)
    assert ask(browser, "typeof hacked") == "undefined"
    assert any("Content Security Policy" in one["message"] for one in browser.get_log("browser"))


# -- charts -----------------------------------------------------------------------------------


def pixels(browser: Any, figure: str, panel: int = 0) -> str:
    """What a chart shows, as an encoded image."""
    return ask(browser, f"document.querySelectorAll('#{figure} canvas')[{panel}].toDataURL()")


def drag(browser: Any, figure: str, first: float, last: float, shift: bool = False) -> None:
    """Drag the mouse over a chart, from a share of its width to another, by the browser."""
    from selenium.webdriver import ActionChains, Keys

    area = browser.find_element("css selector", f"#{figure} .u-over")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", area)
    width = area.size["width"]
    steps = ActionChains(browser, duration=20)
    if shift:
        steps.key_down(Keys.SHIFT)
    steps.move_to_element_with_offset(area, round((first - 0.5) * width), 0).click_and_hold()
    steps.move_by_offset(round(0.5 * (last - first) * width), 0)
    steps.move_by_offset(round(0.5 * (last - first) * width), 0).release()
    if shift:
        steps.key_up(Keys.SHIFT)
    steps.perform()


def stamp(browser: Any, figure: str, share: float) -> float:
    """The time [s] that the legend shows where the mouse is, at a share of the width."""
    from selenium.webdriver import ActionChains

    area = browser.find_element("css selector", f"#{figure} .u-over")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", area)
    x = round((share - 0.5) * area.size["width"])
    ActionChains(browser, duration=20).move_to_element_with_offset(area, x, 0).perform()
    rows = f"document.querySelectorAll('#{figure} .u-series:not([hidden]) td')"
    texts = ask(browser, f"[...{rows}].map(one => one.textContent)")
    (found,) = [text for text in texts if text.endswith(" s")]
    return float(found.removesuffix(" s"))


def test_hovering_shows_the_values_of_all_lines_and_panels(browser, folders):
    look(browser, folders["explained"])
    time_shown = stamp(browser, "free_run", 0.5)
    assert time_shown == pytest.approx(6.0, abs=0.05)  # of 12 s
    cells = "[...document.querySelectorAll('#free_run .u-series')].map(one => [one.querySelector("
    cells += "'.u-label').textContent, parseFloat(one.querySelector('.u-value').textContent)])"
    rows = ask(browser, cells)
    upper, lower = dict(rows[1:4]), dict(rows[5:])
    sample = round(time_shown / 2e-3)
    assert upper["measured"] == pytest.approx(HELD_OUT.outputs[sample, 0], abs=1e-4 * 0.3)
    for label in ("before", "after"):  # the error is that of the lines above it
        assert lower[label] == pytest.approx(upper["measured"] - upper[label], abs=2e-5)


def test_zoom_pan_and_reset_move_all_charts_of_the_record_and_no_other(browser, folders):
    look(browser, folders["explained"])
    names = ("free_run", "held_out_data", "residual")
    whole = {name: pixels(browser, name) for name in names}
    drag(browser, "free_run", 0.25, 0.5)
    assert stamp(browser, "free_run", 0.02) == pytest.approx(3.0, abs=0.15)
    assert stamp(browser, "held_out_data", 0.98) == pytest.approx(6.0, abs=0.15)  # linked
    assert stamp(browser, "residual", 0.98) == pytest.approx(12.0, abs=0.3)  # another record
    drag(browser, "held_out_data", 0.75, 0.25, shift=True)
    assert stamp(browser, "free_run", 0.5) == pytest.approx(6.0, abs=0.15)
    browser.execute_script("document.querySelector('#free_run .tools button').click()")  # zoom in
    time.sleep(0.1)
    assert stamp(browser, "free_run", 0.98) == pytest.approx(6.75, abs=0.1)
    zoomed = {name: pixels(browser, name) for name in names}
    assert [zoomed[name] != whole[name] for name in names] == [True, True, False]
    from selenium.webdriver import ActionChains

    area = browser.find_element("css selector", "#free_run .u-over")
    ActionChains(browser, duration=20).double_click(area).perform()
    time.sleep(0.1)
    assert stamp(browser, "held_out_data", 0.5) == pytest.approx(6.0, abs=0.05)


def test_the_legend_hides_a_line_in_all_panels_by_mouse_and_keyboard(browser, folders):
    look(browser, folders["explained"])
    before = [pixels(browser, "free_run", panel) for panel in (0, 1)]
    entries = browser.find_elements("css selector", "#free_run .u-series th[role=button]")
    assert [one.text for one in entries] == ["measured", "before", "after", "before", "after"]
    browser.execute_script("arguments[0].click()", entries[1])
    hidden = "[...document.querySelectorAll('#free_run .u-off .u-label')].map(o => o.textContent)"
    assert ask(browser, hidden) == ["before", "before"]
    time.sleep(0.1)
    assert all(pixels(browser, "free_run", k) != before[k] for k in (0, 1))
    pressed = (
        "[...document.querySelectorAll('#free_run .u-series th[role]')].map(o => o.ariaPressed)"
    )
    assert ask(browser, pressed) == ["true", "false", "true", "false", "true"]
    browser.execute_script("arguments[0].focus()", entries[3])
    browser.switch_to.active_element.send_keys("\n")
    assert ask(browser, hidden) == []


def test_charts_follow_the_theme_and_the_width_while_they_are_open(browser, folders):
    look(browser, folders["explained"], theme="light")
    page = "document.documentElement.scrollWidth"
    light = pixels(browser, "free_run")
    scheme = [{"name": "prefers-color-scheme", "value": "dark"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    time.sleep(0.2)
    assert pixels(browser, "free_run") != light
    size = {"width": PHONE, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    time.sleep(0.3)
    assert ask(browser, page) <= PHONE
    assert ask(browser, "document.querySelector('#free_run canvas').clientWidth") > 0.85 * PHONE
    assert browser.get_log("browser") == []


def touch(browser: Any, kind: str, *points: tuple[float, float]) -> None:
    places = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
    browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})


def test_two_fingers_zoom_and_one_moves_on_a_phone(browser, folders):
    look(browser, folders["explained"], PHONE)
    area = browser.find_element("css selector", "#free_run .u-over")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", area)
    left, width, top = ask(
        browser,
        "(box => [box.left, box.width, box.top + 40])(document.querySelector("
        "'#free_run .u-over').getBoundingClientRect())",
    )
    at = [(left + share * width, top) for share in (0.1, 0.4, 0.5, 0.6, 0.9)]
    whole = pixels(browser, "free_run")
    touch(browser, "touchStart", at[1], at[3])
    touch(browser, "touchMove", at[0], at[4])  # four times as far apart
    touch(browser, "touchEnd")
    time.sleep(0.1)
    zoomed = pixels(browser, "free_run")
    assert zoomed != whole
    assert stamp(browser, "free_run", 0.02) == pytest.approx(4.5, abs=0.3)
    touch(browser, "touchStart", at[2])
    touch(browser, "touchMove", at[4])
    touch(browser, "touchEnd")
    time.sleep(0.1)
    assert stamp(browser, "free_run", 0.02) == pytest.approx(3.3, abs=0.3)


def test_without_scripts_the_figures_are_there(browser, folders):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        look(browser, folders["explained"])
        browser.execute_cdp_cmd("DOM.getDocument", {"depth": 0})
        # A search needs no number of a node: these last until the driver reads the document itself.
        found = {
            part: browser.execute_cdp_cmd("DOM.performSearch", {"query": path})["resultCount"]
            for part, path in (
                ("svg", "//figure/*[local-name() = 'svg']"),
                ("chart", "//*[contains(concat(' ', @class, ' '), ' chart ')]"),
                ("live", "//figure[contains(concat(' ', @class, ' '), ' live ')]"),
            )
        }
        assert found["svg"] >= 10
        assert found["chart"] == found["live"] == 0
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


def test_the_contents_lead_to_every_section_and_figure(browser, any_run):
    look(browser, any_run)
    links = ask(browser, "[...document.querySelectorAll('nav a')].map(o => o.getAttribute('href'))")
    assert len(links) == len(set(links)) >= 8
    parts = "[...document.querySelectorAll('main > section, figure')].map(one => '#' + one.id)"
    assert sorted(ask(browser, parts)) == sorted(links)


def test_the_badges_tell_the_status_and_the_error_over_the_noise(browser, folders):
    badges = "[...document.querySelectorAll('.badge')].map(one => [one.className, one.textContent])"
    look(browser, folders["explained"])
    run = explained().after
    assert run is not None
    ratio = float(run.rmse[0] / HELD_OUT.noise[0])
    assert ask(browser, badges) == [
        ["badge good", "complete"],
        ["badge", f"held-out error {ratio:.2g} × sensor noise"],
    ]
    look(browser, folders["unexplained"])
    assert ask(browser, badges)[0] == ["badge attention", "unexplained"]
