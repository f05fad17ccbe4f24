#!/usr/bin/python3
"""The page of a run in a headless Chromium: no error, every picture there, and what is clicked does what it should.
usage: report_test.py PROGRAMS CONFIG

PROGRAMS is where simulate, offline and report are. Ends with 77 where no Chromium is installed."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time

# Put before everything else of the page: what goes wrong in it.
WATCH = """<script>
window.problems = [];
window.addEventListener('error', event => problems.push(event.message || 'cannot load ' + event.target.tagName), true);
window.addEventListener('unhandledrejection', event => problems.push(String(event.reason)));
console.error = console.warn = (...words) => problems.push(words.join(' '));
</script>
"""
# Put behind everything else: looks at the page, and clicks.
LOOK = """<script>
const pictures = () => [...document.querySelectorAll('svg.chart, img')].map(picture => {
  const box = picture.getBoundingClientRect();
  return {name: picture.getAttribute('aria-label') || picture.getAttribute('alt'), width: box.width, height: box.height,
          drawn: picture.querySelectorAll('polyline, path, circle, ellipse').length};
});
const shown = () => document.querySelector('#loop-picture p').textContent;
const column = () => [...document.querySelectorAll('#object-table tbody tr')].map(row => row.cells[1].textContent);
const seen = {pictures: pictures(), width: document.documentElement.scrollWidth, loop: shown(), labels: column()};
document.getElementById('loop-before').click();
seen.loopBefore = shown();
const dots = [...document.querySelectorAll('.pick')], last = dots[dots.length - 1];
last.dispatchEvent(new MouseEvent('click', {bubbles: true}));
seen.loopClicked = shown();
seen.clicked = last.dataset.loop;
seen.picturesAfter = pictures();
const label = document.querySelectorAll('#object-table th')[1];
label.click();
seen.sorted = column();
label.click();
seen.sortedDown = column();
seen.problems = problems;
const result = document.createElement('pre');
result.id = 'seen';
result.textContent = JSON.stringify(seen);
document.body.append(result);
</script>
"""


def is_snap(path):
    """Which sees nothing of /tmp; Ubuntu's chromium-browser is a script that asks for one."""
    real = os.path.realpath(path)
    with open(real, 'rb') as file:
        begin = file.read(1000)
    return '/snap/' in real or os.path.basename(real) == 'snap' or (begin[:2] == b'#!' and b'snap' in begin)


def find_browser():
    paths = filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome')))
    return next((path for path in paths if not is_snap(path)), None)


def call(*words):
    run = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True, timeout=200)
    assert run.returncode == 0, f'{words[0]} ends with {run.returncode}: {run.stderr}'
    return run


def make_run(programs, config, work):
    """Of a minute around a simulated desk, with an odometry that drifts. -> its directory"""
    program = lambda name: os.path.join(programs, name)  # noqa: E731
    classes = ['--classes', os.path.join(config, 'classes_coco.yaml')]
    call(program('simulate'), '--output', work, '--seed', '3', '--layout', 'desk', '--duration', '60', '--drift',
         'smooth:0.5:10', '--set', 'trajectory.rate_hz=10', '--camera', os.path.join(config, 'camera', 'tum_fr2.yaml'), *classes)
    run = os.path.join(work, 'run')
    call(program('offline'), '--trajectory', os.path.join(work, 'odometry.txt'), '--detections',
         os.path.join(work, 'detections.json'), '--camera', os.path.join(work, 'camera.yaml'), *classes, '--output', run, '--report', '--groundtruth',
         os.path.join(work, 'groundtruth.txt'), '--reference', os.path.join(work, 'reference_objects.csv'))
    return run


def look_at(browser, page, width, work):
    """Opens the page. -> what LOOK saw in it, and what the browser said on its console"""
    with open(page, encoding='utf-8') as file:
        text = file.read()
    assert text.count('<head>') == 1 and text.count('</body>') == 1
    watched = os.path.join(work, 'watched.html')
    with open(watched, 'w', encoding='utf-8') as file:
        file.write(text.replace('<head>', '<head>' + WATCH).replace('</body>', LOOK + '</body>'))
    run = call(browser, '--headless', '--no-sandbox', '--disable-gpu', '--enable-logging=stderr', '--v=0',
               f'--user-data-dir={work}/profile', f'--window-size={width},1000', '--dump-dom', 'file://' + watched)
    console = [line for line in run.stderr.splitlines() if 'CONSOLE' in line]
    found = re.search('<pre id="seen">(.*?)</pre>', run.stdout, re.S)
    assert found, 'the page did not run to its end: ' + '\n'.join(console)
    seen = found.group(1).replace('&lt;', '<').replace('&gt;', '>').replace('&amp;', '&')
    return json.loads(seen), console


def check(seen, console, width):
    assert not console, console
    assert not seen['problems'], seen['problems']
    names = [picture['name'] for picture in seen['pictures']]
    for name in ('trajectories from above', 'error over time', 'confirmed objects from above', 'loops over time',
                 'time of association', 'time of optimise', 'memory over time'):
        assert name in names, f'{name} is not among {names}'
    assert any(name.startswith('the two submaps of loop') for name in names), names
    for picture in seen['pictures'] + seen['picturesAfter']:
        assert picture['width'] > 200 and picture['height'] > 80, picture
        assert picture['drawn'] > 0, picture
    assert seen['width'] <= width, f"{seen['width']} px wide in a window of {width}"
    assert seen['loopBefore'] != seen['loop'], seen['loop']
    assert seen['loopClicked'].startswith(f"Loop {seen['clicked']}:"), seen['loopClicked']
    assert len(seen['labels']) > 5
    assert seen['sorted'] == sorted(seen['labels'], key=str.lower), seen['sorted']
    assert seen['sortedDown'] == seen['sorted'][::-1] and seen['sorted'] != seen['sortedDown'], seen['sortedDown']


def main(programs, config):
    browser = find_browser()
    if browser is None:
        print('skipped: no Chromium is installed')
        return 77
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as work:
        page = os.path.join(make_run(programs, config, work), 'report.html')
        for width in (1200, 500):
            seen, console = look_at(browser, page, width, work)
            check(seen, console, width)
    print(f"ok: {len(seen['pictures'])} pictures, {time.monotonic() - begin:.0f} s")
    return 0


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
