# SPDX-License-Identifier: Apache-2.0
"""Commands, examples, numbers and links on the pages are correct."""

from collections import Counter
from dataclasses import fields, is_dataclass
import itertools
import json
import os
from pydoc import locate
import re
import shlex
import signal
import subprocess
import sys
import time
from typing import get_args, get_type_hints

from demo_mission import demo_mission
from documented import blocks, ROOT, rows, words
from kbnitp_ros.configuration.field import read_world
from kbnitp_ros.configuration.given import read_sections, values_for
from kbnitp_ros.core import Grid, log_loss
from kbnitp_ros.log import write as log_writer
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.study.scenario import Scenario
from kbnitp_ros.study.scenario_file import read_study
from kbnitp_ros.study.trial import list_trials
from laws import for_each
import pytest

NOTEBOOKS = sorted(ROOT.joinpath('docs/notebooks').glob('*.ipynb'))
ENVIRONMENT = {**os.environ, 'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'}
COMMAND = re.compile(r'^python3 -m kbnitp_ros (\w+) .*$', re.MULTILINE)


def run(program, folder, text=''):
    ran = subprocess.run(
        program,
        input=text,
        cwd=folder,
        env=ENVIRONMENT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert ran.returncode == 0, ran.stdout
    return ran.stdout


def lines(text):
    domain, stamp = r'(?<=ROS_DOMAIN_ID=)\d+', r'(?<=\[)\d+\.\d+(?=\])'
    varies = '|'.join((domain, stamp, r'\d+ of \d+(?= messages)'))
    return {line for line in re.sub(varies, '', text).splitlines() if line.strip()}


def follow(page, folder):
    """Execute a page's blocks, one after another, in a folder."""
    printed = ''
    for language, block in blocks(page):
        file = re.match(r'# (\w+\.\w+)\n', block)
        if language == 'text':
            assert lines(block) <= lines(printed), lines(block) - lines(printed)
        elif language in ('bash', 'python'):
            program = ['bash', '-e'] if language == 'bash' else [sys.executable, '-']
            printed = run(program, folder, block)
        else:
            assert file, f'nobody reads a block that begins {block[:40]!r}'
        if file and language != 'text':
            folder.joinpath(file[1]).write_text(block)


# Missions over DDS take a while; the other tests run the same commands with other values.
@pytest.mark.full
@pytest.mark.processes
@pytest.mark.parametrize('name', sorted(ROOT.joinpath('docs/tutorials').glob('*.md')))
def test_a_tutorial(name, tmp_path):
    if name.stem == 'gymnasium':
        pytest.importorskip('gymnasium', reason='gymnasium is not installed')
    follow(name.relative_to(ROOT), tmp_path)


@pytest.mark.full
@pytest.mark.processes
def test_commands_of_a_page_work_in_order(tmp_path):
    """A study, which takes hours, runs with few robots, and a forecast with fewer missions."""
    tmp_path.joinpath('hidden.yaml').write_text(shown('world'))
    tmp_path.joinpath('config').symlink_to(ROOT / 'config')
    made = Counter()
    pages = 'README', 'docs/commands', 'docs/field', 'docs/files', 'docs/which_field'
    for page in pages:
        for line in COMMAND.finditer(
            ''.join(text for kind, text in blocks(f'{page}.md') if kind == 'bash')
        ):
            words_of = [sys.executable, *shlex.split(line[0])[1:]]
            made[line[1]] += 1
            if line[1] == 'study':
                out = tmp_path / words_of[-1]
                few = [*words_of, '--set', 'robots=2']
                study = subprocess.Popen(few, cwd=tmp_path, env=ENVIRONMENT)
                deadline = time.monotonic() + 120
                while not list(out.glob('trials/*.npz')) and time.monotonic() < deadline:
                    time.sleep(0.1)
                study.send_signal(signal.SIGINT)
                assert study.wait(timeout=180) == 130
            else:
                run([*words_of, *['--worlds', '2'] * (line[1] == 'forecast')], tmp_path)
    assert made == {'demo': 8, 'replay': 1, 'report': 1, 'study': 10, 'forecast': 1, 'layout': 2}
    assert {'small', 'small_report', 'paper', 'team', 'forecast', 'hidden'} <= {
        each.name for each in tmp_path.joinpath('runs').iterdir()
    }
    assert list(tmp_path.glob('runs/paper/trials/*.npz'))


@for_each(
    'page, printed',
    [('docs/commands.md', None), ('docs/decisions.md', 'True'), ('docs/which_field.md', '')],
)
def test_an_example_in_python_prints_the_stated_output(page, printed, capsys):
    (example,) = (block for language, block in blocks(page) if language == 'python')
    exec(example, {})
    told = capsys.readouterr().out
    assert example.endswith(f'# {told}') if printed is None else told.endswith(f'{printed}\n')


@pytest.mark.full
@pytest.mark.processes
def test_the_readme_compares_the_printed_update_with_the_exact_one(tmp_path):
    text, ends = words('README.md'), {}
    for method, options in (
        ('kappa_bnitp_published', []), ('kappa_bnitp', ['--set', 'learn.numbers=[]']),
    ):  # fmt: skip
        command = [sys.executable, '-m', 'kbnitp_ros', 'demo', '--method', method, *options]
        printed = run([*command, '--out', str(tmp_path / method)], tmp_path)
        lost, entropy = (
            re.findall(each, printed)[-1] for each in (r'(\d+) lost;', r'-> ([\d.]+) nats')
        )
        ends[method] = lost, entropy
    (printed_lost, printed_nats), (exact_lost, exact_nats) = ends.values()
    assert f'{printed_lost} of 100 robots are lost under the printed update' in text
    assert f'and {exact_lost} under the exact one' in text
    assert f'the entropy ends at {printed_nats} and {exact_nats} nats' in text


def shown(name):
    """Return the page's example of a kind of file."""
    (text,) = (text for _, text in blocks('docs/files.md') if text.startswith(f'# {name}\n'))
    return text


def test_files_are_read_as_the_page_shows_them(tmp_path):
    for name in ('parameters', 'world', 'scenario'):
        tmp_path.joinpath(f'{name}.yaml').write_text(shown(name))
    sections = read_sections(tmp_path / 'parameters.yaml')
    values = {
        name: values_for(sections, name) for name in ('/agent', '/planner', '/north/planner')
    }
    assert [values[name]['sensor.lethality'] for name in ('/agent', '/planner')] == [0.6, 0.3]
    assert 'robots' not in values['/planner']
    assert values['/north/planner']['robots'] == 40
    world = read_world(tmp_path / 'world.yaml', Grid(4, 3))
    assert world.hazard.nonzero()[0].tolist() == [1, 10]
    assert world.target.nonzero()[0].tolist() == [1, 4, 10]
    trials = len(list_trials(read_study(tmp_path / 'scenario.yaml')))
    assert f'= {trials} missions' in words('docs/files.md')
    missing = [key for key in keys_in(Scenario) if not re.search(rf'\b{key}:', shown('scenario'))]
    assert missing == []


def keys_in(kind):
    for name, hint in get_type_hints(kind).items():
        yield name
        for inner in (hint, *get_args(hint)):
            if is_dataclass(inner):
                yield from (field.name for field in fields(inner))


@pytest.mark.slow
def test_numbers_of_the_demo_are_correct():
    first, deployments, world, _ = demo_mission()
    beliefs = [first, *(deployment.belief for deployment in deployments)]
    entropy = [f'{belief.entropy():.1f}' for belief in beliefs]
    loss = [
        f'{log_loss(belief.hazard, world.hazard) + log_loss(belief.target, world.target):.1f}'
        for belief in beliefs
    ]
    gained = [
        f'{before.joint_entropy() - after.joint_entropy():.1f}'
        for before, after in itertools.pairwise(beliefs)
    ]
    lost = sum(not each.observation.survived for each in deployments)
    known = [
        f'{deployments[-1].parameters[name].quantile(q):.2f}'
        for name in ('lethality', 'hazard_density')
        for q in (0.05, 0.5, 0.95)
    ]
    told = {
        'README.md': [f'{lost} were lost', entropy[0], entropy[-1], len(deployments)],
        'docs/reading.md': [
            *(entropy[robots] for robots in (0, 3, 7, 100)), loss[1], loss[-1], *known,
            *(gained[robot - 1] for robot in (46, 76, 91, 45, 65, 73)),
        ],
    }  # fmt: skip
    for page, numbers in told.items():
        assert [each for each in map(str, numbers) if each not in words(page)] == [], page


def test_quality_of_service_and_possible_losses_are_as_stated():
    topics = rows('docs/topics.md', 'QoS')
    for topic, profile in (
        ('belief', qos.LATCHED),
        ('belief/hazard', qos.LATCHED),
        ('/tf', qos.POSES),
    ):
        (line,) = (cells for head, cells in topics.items() if head.split('`')[0] == topic)
        assert line[-1].endswith(f', {profile.depth}'), topic
        assert ('transient local' in line[-1]) == (profile is qos.LATCHED)
    assert f'at most {log_writer.CHUNK // 2**20} MiB of them' in words('docs/log.md')


def test_the_glossary_names_existing_code():
    glossary = ROOT.joinpath('docs/glossary.md').read_text()
    names = re.findall(r'`(core\.[\w.]+)`', glossary)
    assert names
    assert [name for name in names if locate(f'kbnitp_ros.{name}') is None] == []


def outputs(path):
    """
    Return the cells of a notebook, and the texts and kinds of pictures that stand below each.

    Pictures differ with a machine's fonts, and a kernel sends text in any number of pieces.
    """
    cells = []
    for cell in json.loads(path.read_text())['cells']:
        if cell['cell_type'] == 'code':
            streams, kinds = {}, []
            for output in cell['outputs']:
                if 'name' in output:
                    name, text = output['name'], ''.join(output['text'])
                    streams[name] = streams.get(name, '') + text
                else:
                    kinds.append((output['data'].get('text/plain'), sorted(output['data'])))
            cells.append((cell['source'], cell.get('execution_count'), streams, kinds))
    return cells


@pytest.mark.processes
@pytest.mark.full
def test_notebooks_show_what_comes_out(tmp_path):
    pytest.importorskip('nbclient', reason='notebooks are executed with the wheels only')
    run([sys.executable, ROOT / 'tools/notebooks.py', tmp_path], ROOT)
    for path in NOTEBOOKS:
        assert outputs(path) == outputs(tmp_path / path.name), 'python3 tools/notebooks.py'
        assert any(streams or kinds for *_, streams, kinds in outputs(path))


PAGES = [
    *(path for folder in ('', 'msg_defs') for path in sorted((ROOT / folder).glob('*.md'))),
    *sorted(ROOT.joinpath('docs').rglob('*.md')),
    *NOTEBOOKS,
]


def page_text(path):
    said = path.read_text()
    if path.suffix == '.ipynb':
        cells = json.loads(said)['cells']
        said = '\n\n'.join(''.join(e['source']) for e in cells if e['cell_type'] == 'markdown')
    return re.sub(r'^```.*?^```', '', said, flags=re.MULTILINE | re.DOTALL)


def anchors(said):
    count = Counter()
    for heading in re.findall(r'^#+ (.+?)\s*$', said, re.MULTILINE):
        title = re.sub(r'\[(.*?)\]\(.*?\)', r'\1', heading).lower()
        name = re.sub(r'[^\w\- ]', '', title).replace(' ', '-')
        yield f'{name}-{count[name]}' if count[name] else name
        count[name] += 1


def dead(path):
    for link in re.findall(r'\]\(<?([^)\s>]+)>?\)', page_text(path)):
        if re.match(r'\w+:', link):
            continue
        file, _, anchor = link.partition('#')
        target = path.parent / file if file else path
        if not target.exists() or (anchor and anchor not in anchors(page_text(target))):
            yield link


@for_each('path', PAGES)
def test_links_have_targets(path):
    assert list(dead(path)) == []


NAMED = re.compile(r'(?<![\w/.-])(\w+(?:/[\w-]+)+\.(?:py|md|yaml|msg|sh|xml|js|c))\b')


@pytest.mark.processes
def test_files_that_comments_and_pages_name_exist():
    tracked = subprocess.run(['git', 'ls-files'], cwd=ROOT, capture_output=True, text=True).stdout
    names = tracked.split()
    if not names:
        pytest.skip('not a clone')
    tops = {name.split('/')[0] for name in names} | {
        name.split('/')[1] for name in names if name.startswith('kbnitp_ros/')
    }
    for name in names:
        path = ROOT / name
        if name.startswith(('test/', 'CHANGELOG')) or path.suffix not in (
            '.py', '.md', '.msg', '.srv', '.sh', '.yaml', '.xml', '.txt', '.cfg',
        ):  # fmt: skip
            continue
        for named in NAMED.findall(path.read_text()):
            if named.split('/')[0] in tops:
                places = (ROOT, ROOT / 'kbnitp_ros', path.parent, ROOT / 'docs')
                assert any(place.joinpath(named).exists() for place in places), (name, named)


def test_what_was_run_is_what_is_pinned():
    ran = words('docs/distributions.md')
    run = ROOT.joinpath('requirements/run.txt').read_text()
    assert f'rclpy {re.search("rclpy.*==([0-9]+[.][0-9]+)", run)[1]}' in ran
    assert 'CPython 3.10 to 3.13' in run
    assert 'Python 3.10 to 3.13' in ran


DERIVATIONS = [ROOT / 'docs/mathematics.md', *sorted(ROOT.glob('docs/mathematics/*.md'))]
TEXT = '\n'.join(page.read_text() for page in DERIVATIONS)
LABELS = re.findall(r'^ *:label: (\S+)$', TEXT, re.MULTILINE)


def test_equations_have_labels_that_the_code_cites_and_no_others():
    cited = {
        label
        for folder in ('kbnitp_ros', 'benchmarks')
        for path in sorted((ROOT / folder).rglob('*.py'))
        for label in re.findall(r':eq:`([^`]*)`', path.read_text())
    }
    assert [label for label, times in Counter(LABELS).items() if times > 1] == []
    assert cited == set(LABELS)


def numbers_in(labels):
    ranges = re.findall(r'(\d+)(?:-(\d+))?', ' '.join(labels))
    return sorted(n for first, last in ranges for n in range(int(first), int(last or first) + 1))


def test_each_line_and_equation_of_the_paper_has_a_function_and_a_test():
    table = rows('docs/mathematics.md', 'in the paper')
    for label, (_, name, test) in table.items():
        docstring = ' '.join(locate(f'kbnitp_ros.{name}').__doc__.split())
        assert re.search(rf'{re.escape(label)}\b', docstring), (label, name)
        path, function = test.split('::')
        assert f'\ndef {function}(' in ROOT.joinpath(path).read_text(), test
    lines, equations = (
        [label.removeprefix(head) for label in table if label.startswith(head)]
        for head in ('Algorithm 1, ', 'eq. ')
    )
    assert numbers_in(lines) == [*range(1, 13)]
    assert numbers_in(equations) == [*range(1, 12)]
