"""A page in a browser without a window: what it complains of, and which of its texts overlap or are cut off."""

import html
import json
import re
import shutil
import subprocess
import zlib
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')  # which forbids what a test adds to a page
TOKEN = re.compile(r"\((?:\\.|[^\\)])*\)|<[^>]*>|[^\s\[\]()<>]+")  # of a PDF's page: a string, a number, an operator
NEAR = 1.5  # pixels by which boxes of text may touch: they have room above and below their letters
PROBE = """
<script>
const beside = (a, b) => a.right <= b.left + NEAR || b.right <= a.left + NEAR;
const apart = (a, b) => beside(a, b) || a.bottom <= b.top + NEAR || b.bottom <= a.top + NEAR;
const within = (a, b) => a.left >= b.left - NEAR && a.right <= b.right + NEAR;
const inside = (a, b) => within(a, b) && a.top >= b.top - NEAR && a.bottom <= b.bottom + NEAR;
const shown = box => box.width > 0.5 && box.height > 0.5;
const drawn = () => [...document.querySelectorAll("svg:not(.key)")].filter(svg => svg.getClientRects().length);
const words = leaf => leaf.textContent.trim().slice(0, 50);

function pictures(out) {
  for (const svg of drawn()) {
    const frame = svg.getBoundingClientRect(), before = [];
    for (const text of svg.querySelectorAll("text")) {
      const full = text.getBoundingClientRect(), cut = full.height * 0.18;  // letters are lower than their line
      const box = new DOMRect(full.x, full.y + cut, full.width, full.height - 2 * cut);
      if (!words(text)) continue;
      if (!inside(box, frame)) out.push("leaves its picture: " + words(text));
      for (const [other, said] of before) if (!apart(box, other)) out.push("overlap: " + words(text) + " / " + said);
      before.push([box, text.textContent.trim()]);
    }
    if (!shown(frame) || !before.length) out.push("an empty picture");
    const label = svg.closest("[aria-label]")?.getAttribute("aria-label") ?? "";
    if (label.length < 20) out.push("a picture without words");
    if (!before.some(([, said]) => /\\[.+\\]/.test(said))) out.push("a picture without a unit: " + label.slice(0, 50));
  }
}

function texts(out, wide) {
  const boxes = [];
  for (const leaf of document.querySelectorAll("h1, h2, h3, h4, p, td, th, dt, dd, summary, a")) {
    const range = document.createRange();
    range.selectNodeContents(leaf);
    const box = range.getBoundingClientRect();
    if (!shown(box) || leaf.closest(".wide, .picture, .matrix")) continue;
    if (leaf.closest("details:not([open]) > :not(summary)")) continue;
    if (box.right > wide + NEAR) out.push("cut off: " + words(leaf));
    if (leaf.matches("a") || leaf.querySelector("table")) continue;
    for (const [other, said] of boxes) if (!apart(box, other)) out.push("overlap: " + words(leaf) + " / " + said);
    boxes.push([box, words(leaf)]);
  }
}

function told() {
  const out = [], wide = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > wide + 1) out.push("the page is wider than its window");
  pictures(out);
  texts(out, wide);
  for (const box of document.querySelectorAll(".wide, .picture")) {
    if (box.scrollWidth <= box.clientWidth + 1) continue;
    if (PAPER || wide >= 1000) out.push("cut off at desktop width or on paper: " + words(box));
    else if (getComputedStyle(box.nextElementSibling).display == "none") out.push("scrolls and does not say so");
  }
  return {pictures: drawn().length, wide: wide, complaints: out};
}
addEventListener("load", () => setTimeout(() => parent.postMessage(JSON.stringify(told()), "*"), 300));
</script>
""".replace("NEAR", str(NEAR))


def inspect_page(page, folder, width, paper=False):
    """What is wrong with a page `width` pixels wide, or as it is printed: how many pictures, complaints, console messages."""
    text = POLICY.sub("", page.read_text())
    text = text.replace("@media print", "@media all") if paper else text
    inner, outer = folder / f"inner-{width}.html", folder / f"outer-{width}.html"
    inner.write_text(text.replace("</body>", PROBE.replace("PAPER", "true" if paper else "false") + "</body>"))
    outer.write_text(
        "<title>waiting</title><script>addEventListener('message', e => { document.title = 'told';"
        "document.body.append(Object.assign(document.createElement('pre'), {id: 'told', textContent: e.data})); });</script>"
        f"<iframe src='{inner.as_uri()}' style='width:{width}px;height:2000px;border:0'></iframe>"
    )
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000"]
    words += ["--enable-logging=stderr", "--v=0", "--window-size=1600,2000", "--dump-dom", outer.as_uri()]
    done = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.S)
    if not found:
        raise RuntimeError(f"the page said nothing of itself: {done.stderr[-400:]}")

    told = json.loads(html.unescape(found.group(1)))
    told["console"] = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return told


def devtools(profile):
    """A browser that is controlled by its DevTools protocol: that of `.ci/search`."""
    loader = SourceFileLoader("search", str(Path(__file__).parents[2] / ".ci" / "search"))
    search = module_from_spec(spec_from_loader("search", loader))
    loader.exec_module(search)
    return search.Browser(str(profile))


def print_page(page, folder):
    """Print a page to PDF, and return the size in points of each text on paper."""
    out = folder / "printed.pdf"
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={out}"]
    subprocess.run([*words, page.as_uri()], capture_output=True, timeout=900, check=True)
    return [size for text in _streams(out.read_bytes()) for size in _text_sizes(text)]


def _streams(pdf):
    """Yield the content streams of a PDF that have text."""
    for found in re.finditer(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.S):
        try:
            text = zlib.decompress(found[1]).decode("latin-1")
        except zlib.error:  # of an image
            continue
        if " Tf" in text:
            yield text


def _text_sizes(text):
    """Yield the size of each text of a content stream: the font's, times the scales of the matrices in force."""
    scale, line, kept, size, numbers = 1.0, 1.0, [], 0.0, []
    for token in TOKEN.findall(text):
        if token == "q":
            kept.append(scale)
        elif token == "Q":
            scale = kept.pop()
        elif token in ("cm", "Tm"):
            a, b, c, d = map(float, numbers[-6:-2])
            by = abs(a * d - b * c) ** 0.5
            scale, line = (scale * by, line) if token == "cm" else (scale, by)
        elif token == "BT":
            line = 1.0
        elif token == "Tf":
            size = float(numbers[-1])
        elif token in ("Tj", "TJ"):
            yield size * scale * line
        numbers = [*numbers, token] if re.match(r"[-+.\d]", token) else []


if __name__ == "__main__":  # python tests/support/browser.py report.html
    import sys
    import tempfile

    for name in sys.argv[1:]:
        for width, paper in ((390, False), (1024, False), (1400, False), (718, True)):
            with tempfile.TemporaryDirectory() as folder:
                told = inspect_page(Path(name).absolute(), Path(folder), width, paper)
            print(name, f"{width} px", "as printed" if paper else "", f"{told['pictures']} pictures")
            print("\n".join(f"    {line}" for line in [*told["complaints"], *told["console"]][:40]))
