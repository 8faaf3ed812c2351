// The board of `watch --control`: how the mission stands, what waits for a person, and orders. docs/board.md says what it reads and
// sends.

// Milliseconds without a word from the server after which the connection counts as lost, between two tries, and to wait for an answer:
// the server says something every 5 s, and answers within 30 s.
const SILENT = 12_000;
const AGAIN = 1000;
const MAX_WAIT = 40_000;

// What the dialog says while an order is repeated.
const NO_ANSWER = 'No answer so far: asking again.';

// Confidence above which a finding of no hazard asks for the number of its cells.
const CLEARED = 0.9;

// What a person says of a deployment, by the number of its kind.
const KINDS = {
  1: 'wreck: it was lost there', 2: 'no hazard: a flat battery', 3: 'recovered: carried home', 4: 'withdraw: it says nothing', 5: 'lost before the change',
  6: 'lost after the change',
};
const [LOCATED, NO_HAZARD, RECOVERED] = [1, 2, 3];

// What waits for the operator, where its buttons say the rest.
const WAITS = { PAUSED: 'departures are on hold', GOAL_LOST: 'the goal was reached, and no longer holds: no robot leaves' };

// Why the planner keeps a robot at its base.
const KEPT = { BATTERY: 'kept until its battery suffices', READY: 'kept until its agent says that it is ready', SEPARATION: 'kept until the others have gone' };

// The board as it was sent last, and the cells that are marked.
let board = null;
const markedCells = new Set();
let isMarking = false;
// Time of the last word of the server, and its clock less that of this machine, in milliseconds.
let wordAt = 0;
let ahead = 0;
// The words on a lost connection; empty while it stands.
let lostWords = '';
// What waited at the last board, and the order in the dialog.
let waiting = null;
let act = null;
let sound = null;
// What is held down, by a finger or a mouse.
let heldDown = null;
// Previews of this page: others see them on the board.
const own = new Set();
const put = new Map();

const share = (number) => (number === null ? 'unknown' : number.toFixed(3).replace(/^0/, ''));
// Deployments by their numbers: 'scout_1 at 1795957717.760562219' is 'no. 3 of scout_1'.
const numbered = (text) => text.replace(/([^\s;,:]+) at ([0-9]+)[.]([0-9]{9})/g, (all, agent, sec, nanosec) => (
  deploymentsKnown().find((each) => each.agent === agent && sameDeployment(each.deployment, { sec: Number(sec), nanosec: Number(nanosec) }))?.name ?? all));
const words = (name) => name.toLowerCase().replaceAll('_', ' ');
const clockTime = (seconds) => new Date(1000 * seconds - ahead).toTimeString().slice(0, 8);
const counted = (number, name) => `${number} ${name}${number === 1 ? '' : 's'}`;
const present = () => (Date.now() + ahead) / 1000;

function span(seconds) {
  const all = Math.max(0, Math.floor(seconds));
  const [hours, minutes, rest] = [Math.floor(all / 3600), Math.floor(all / 60) % 60, all % 60];
  const two = (number) => String(number).padStart(2, '0');
  return hours ? `${hours}:${two(minutes)}:${two(rest)}` : `${minutes}:${two(rest)}`;
}

// A button of the board; `key` finds it again after its part was made anew.
function orderButton(text, key, run, attributes = {}) {
  const made = element('button', text, { type: 'button', className: 'act', ...attributes });
  made.dataset.key = key;
  made.addEventListener('click', run);
  return made;
}

// Make a part anew if its facts have changed; the focus stays. A part in which a button is held down waits for the click.
function renewPart(id, facts, parts) {
  const text = JSON.stringify(facts);
  if (put.get(id) === text || page(id).contains(heldDown)) return;
  put.set(id, text);
  const key = page(id).contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  page(id).replaceChildren(...parts());
  if (key) page(id).querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus();
}

// A time that runs: 'since' and 'until' are seconds since 1970.
function running(text, kind, at) {
  const made = element('span', '', { className: 'running' });
  Object.assign(made.dataset, { kind, at, text });
  return made;
}

function tick() {
  document.querySelectorAll('.running').forEach((each) => {
    const { kind: way, at, text } = each.dataset;
    const seconds = way === 'since' ? present() - at : at - present();
    each.textContent = `${way === 'until' && seconds < 0 ? 'overdue by' : text} ${span(Math.abs(seconds))}`;
  });
}

const sameDeployment = (one, other) => one && other && one.sec === other.sec && one.nanosec === other.nanosec;

// Whatever waits for a person: what the board says, and robots that are overdue.
function needsNow() {
  const overdue = board.robots.filter((each) => each.overdue).map((each) => ({ what: 'overdue', agent: each.name, deployment: each.deployment, due: each.due }));
  return [...board.needs.filter((each) => !own.has(each.nonce)), ...overdue];
}

const keyOf = ({ what, agent, deployment, nonce, obstacle, cells }) => JSON.stringify([what, agent, deployment, nonce, obstacle, cells]);

const proposals = () => board.needs.filter((each) => each.what === 'approval');

function needRow(need) {
  const { what, agent, deployment } = need;
  const key = keyOf(need);
  const say = (text, ...buttons) => element('li', [element('span', text), ' ', ...buttons.flatMap((each) => [each, ' '])]);
  if (what === 'approval') {
    // The operator decides on all paths of a round together.
    const paths = proposals();
    if (need.agent !== paths[0].agent) return [];
    return say(
      `approve ${paths.map((each) => `${each.agent} (returns with ${share(each.returns)})`).join(', ')}`,
      ...paths.map((each) => orderButton(
        paths.length > 1 ? `look at ${each.agent}` : 'look', `look ${each.agent}`, () => lookAt(each.cells[Math.floor(each.cells.length / 2)]), { className: '' },
      )),
      orderButton('approve', 'approve', () => proposePlans('approve')), orderButton('refuse', 'refuse', () => proposePlans('refuse')),
    );
  }
  if (what === 'held') return say(`${agent} is held: ${numbered(need.why)}`, orderButton('decide', key, () => proposeAnnotation({ agent, deployment }, NO_HAZARD)));
  if (what === 'overdue') {
    return say(
      [`${agent} is `, running('due in', 'until', need.due)], orderButton('lost', `lost ${key}`, () => proposeLoss(agent)),
      orderButton('say', `say ${key}`, () => proposeAnnotation({ agent, deployment }, LOCATED)),
    );
  }
  if (what === 'mission') {
    const resume = board.mission.hold ? [orderButton('resume', `resume ${key}`, proposeResume)] : [];
    return say(WAITS[need.obstacle] ?? numbered(need.why), ...resume, orderButton('end', `end ${key}`, proposeEnd));
  }
  return say(`${need.stale ? 'stale preview' : 'preview'} of ${words(need.order)}: ${numbered(need.message)}`);
}

function robotRow(robot) {
  const { name, deployment, out } = robot;
  const said = element('p', [element('strong', name), ' ']);
  if (out) said.append(...(robot.out_since === null ? [robot.taken_back ? 'has an order that is taken back' : 'has an order'] : [running('out', 'since', robot.out_since), ', ', running('due in', 'until', robot.due)]));
  else {
    said.append(robot.state === null ? 'was never heard' : robot.state === 'OUT' ? 'not back' : words(robot.state));
    if (robot.since !== null) said.append(' ', running('for', 'since', robot.since));
    if (robot.waits_for && robot.at_base) said.append(`, ${KEPT[robot.waits_for]}`);
  }
  const more = [
    robot.reason, robot.at_base === false && !out && 'away from its base', robot.battery !== null && `battery ${Math.round(100 * robot.battery)} %`,
    robot.age === null && robot.state !== null && 'not heard', robot.number && `no. ${robot.number}`,
  ].filter(Boolean);
  if (more.length) said.append(` · ${more.join(' · ')}`);
  const aged = element('span', [], { className: 'age' });
  aged.dataset.agent = name;
  said.append(aged);
  const buttons = deployment ? [
    ...(out && robot.out_since === null && !robot.taken_back ? [orderButton('take back', `take back ${name}`, () => proposeTakeBack(name))] : []),
    ...(out ? [orderButton('lost', `lost ${name}`, () => proposeLoss(name))] : []),
    orderButton('wreck', `wreck ${name}`, () => proposeAnnotation({ agent: name, deployment }, LOCATED)),
    orderButton('recovered', `recovered ${name}`, () => proposeAnnotation({ agent: name, deployment }, RECOVERED)),
    orderButton('more', `more ${name}`, () => proposeAnnotation({ agent: name, deployment }, NO_HAZARD), { ariaLabel: `say more of ${name}` }),
  ] : [];
  return element('li', [said, element('p', buttons.flatMap((each) => [each, ' ']))], { className: robot.overdue ? 'overdue' : '' });
}

const deploymentNamed = (given) => deploymentsKnown(given).find((each) => each.agent === given.agent && sameDeployment(each.deployment, given.deployment)).name;

// A statement in words.
function statement(said) {
  const isOfRobot = said.kind === 'annotation';
  const of = isOfRobot ? `${deploymentNamed(said)}: ` : '';
  const at = said.changed ? ` at ${clockTime(said.since)}` : '';
  const cells = !isOfRobot && said.cells.length ? `, ${counted(said.cells.length, 'cell')}` : '';
  return `${of}${said.words}${at}${cells}`;
}

// What a statement changed, if this board sent it.
function effectInWords({ p_free: free, hazards }) {
  const [name, [before, after], shown] = free[0] === null ? ['expected hazards', hazards, (each) => each.toFixed(1)] : [`${board.goal?.kind ?? 'goal'} free`, free, share];
  return `, ${name} ${shown(before)} → ${shown(after)}`;
}

function saidRow(said) {
  const others = board.contradictions.filter(({ findings }) => findings.includes(said.hash)).length;
  const text = `${clockTime(said.time)} ${said.author || 'somebody'}: ${statement(said)}${said.note ? ` (${said.note})` : ''}`;
  const row = element('li', text + (said.effect ? effectInWords(said.effect) : ''), { className: said.holds ? '' : 'over' });
  if (others) row.append(element('strong', ' contradicts another finding'));
  if (said.revoked_by !== null) row.append(` taken back by ${said.revoked_by || 'somebody'} at ${clockTime(said.revoked_at)}`);
  if (said.holds && said.hash && said.kind !== 'revocation') row.append(' ', orderButton('revoke', said.hash, () => proposeRevocation(said)));
  if (said.cells.length) row.append(' ', orderButton('look', `look ${said.hash} ${said.time}`, () => lookAt(said.cells[0]), { className: '' }));
  return row;
}

function parameterRow([name, value]) {
  const id = `set-${name}`;
  const input = typeof value === 'boolean' ? element('input', [], { id, type: 'checkbox', checked: value })
    : element('input', [], { id, type: 'number', step: 'any', value: value ?? '', disabled: value === null });
  input.dataset.key = id;
  return element('p', [
    element('label', [`${name.replaceAll('_', ' ')} `, input]), ' ',
    orderButton('set', `button ${name}`, () => proposeParameter(name, value, typeof value === 'boolean' ? input.checked : input.valueAsNumber), {
      disabled: value === null, ariaLabel: `set ${name}`,
    }),
  ]);
}

function goalInWords({ kind: what, p_free, confidence, reached, trusted }) {
  const names = trusted.map((each) => words(each.name));
  const wanted = confidence ? ` of ${share(confidence)}` : '';
  return `${what} free with ${share(p_free)}${wanted}${reached ? ', reached' : ''}${names.length ? `, trusts ${names.join(', ')}` : ''}`;
}

// The checks of the robots before the first departure: a heading with their number, and those that are red.
function drawPreflight(checks) {
  const red = checks.filter(({ light }) => light === 'RED');
  page('preflight-part').hidden = !checks.length;
  page('preflight-title').textContent = `Preflight: ${checks.length - red.length} of ${checks.length}`;
  renewPart('preflight', red, () => red.map(({ name, text }) => element('li', `${name}: ${text}`)));
}

function drawBoard() {
  const { mission: { state, sent, out, lost, held, hold, age, name, ends_by, reason }, goal, open } = board;
  page('state').textContent = state.replaceAll('_', ' ');
  page('counts').textContent = `${sent} sent, ${out} out, ${lost} lost${held ? `, ${held} held` : ''}`;
  page('goal').textContent = goal ? goalInWords(goal) : '';
  page('heard').textContent = age ? `planner silent for ${span(age)}` : 'live';
  page('heard').className = age ? 'alarm' : '';
  // Whatever the operator ends is below.
  page('reason').textContent = ends_by === 'OPERATOR' ? '' : numbered(reason);
  const others = open.act + open.look - 1;
  page('open').textContent = others > 0 ? `${counted(others, 'other page')} open` : '';
  renewPart('hold', hold, () => [hold ? orderButton('Resume', 'hold', proposeResume) : orderButton('HOLD: robots out are not stopped', 'hold', stopAll)]);
  const needs = needsNow();
  page('needs-title').hidden = !needs.length;
  renewPart('needs', [needs, hold], () => needs.flatMap(needRow));
  const rank = (robot) => (robot.overdue ? 0 : robot.out ? 1 : 2);
  drawPreflight(board.preflight);
  const robots = [...board.robots].sort((one, other) => rank(one) - rank(other));
  // Ages change each second, and make no button anew.
  renewPart('robots', robots.map((robot) => ({ ...robot, age: robot.age === null })), () => robots.map(robotRow));
  page('robots').querySelectorAll('.age').forEach((each) => {
    const { age: heard } = robots.find((robot) => robot.name === each.dataset.agent);
    each.textContent = heard ? ` · last heard ${span(heard)} ago` : '';
  });
  renewPart('statements', [board.said, board.contradictions], () => (board.said.length ? [...board.said].reverse().map(saidRow) : [element('li', 'nothing so far')]));
  renewPart('parameters', board.parameters, () => Object.entries(board.parameters).map(parameterRow));
  const next = JSON.stringify(proposals());
  if (mission && put.get('map') !== next) {
    put.set('map', next);
    drawMap();
  }
  tick();
  const keys = needs.filter(({ what }) => what !== 'preview').map(keyOf);
  if (waiting && keys.some((key) => !waiting.includes(key))) beep();
  waiting = keys;
  document.title = `${keys.length ? `(${keys.length}) ` : ''}${name}`;
}

// On the map: paths that wait for approval.
function boardMarks() {
  const next = line(board ? proposals().map((each) => each.cells) : []);
  return [
    scatter('lines', next, { line: { color: '#ffffff', width: 6 } }),
    scatter('lines', next, { name: 'next', line: { color: '#e69f00', width: 3, dash: 'dashdot' } }),
  ];
}

function lookAt(each) {
  look(each);
  page('map').scrollIntoView({ block: 'center' });
  maps.get('map').see(each);
}

// Mark cells, or take the mark of a marked one away.
function mark(found) {
  const isMarked = found.length === 1 && markedCells.has(found[0]);
  found.forEach((each) => (isMarked ? markedCells.delete(each) : blocked.has(each) || markedCells.add(each)));
  showMarks();
}

// A cell that is chosen is marked alone, unless cells are added.
function markChosen(each) {
  if (!board || isMarking) return;
  markedCells.clear();
  mark([each]);
}

// Mark the cell at the typed coordinates.
function goToCell() {
  if (!named()) return;
  if (isMarking && !markedCells.has(cell)) mark([cell]);
  maps.get('map').see(cell);
}

function showMarks() {
  page('marked').textContent = markedCells.size ? `${counted(markedCells.size, 'cell')} marked` : 'No cell is marked: click on cells, or type x and y.';
  maps.get('map')?.render();
}

function switchMarking() {
  isMarking = !isMarking;
  page('mark').setAttribute('aria-pressed', isMarking);
  maps.get('map').onMark = isMarking ? mark : null;
  showMarks();
}

// The dialog: fields, then what would change, then the order.

function input(label, name, attributes = {}) {
  const made = element('input', [], { name, ...attributes });
  return element('label', attributes.type === 'checkbox' ? [made, ` ${label}`] : [`${label} `, made]);
}

function choice(label, name, options, value) {
  const made = element('select', Object.entries(options).map(([key, text]) => element('option', text, { value: key, selected: key === String(value) })), { name });
  return element('label', [`${label} `, made]);
}

const number = (label, name, given, attributes = {}) => input(label, name, { type: 'number', step: 'any', required: true, value: given, ...attributes });
const note = () => input('note', 'note', { maxLength: 200 });

// Open the dialog of an order: {title, order, fields, arguments: from the values of the fields, lines: what it does where the service has
// no preview, warning, confirm: what a person must type, from the preview}.
function propose(made) {
  act = { preview: null, ...made };
  page('act-title').textContent = made.title;
  page('act-warning').textContent = made.warning;
  const author = made.isSigned ? [input('your name', 'author', { required: true, maxLength: 200, value: sessionStorage.getItem('author') ?? '', autocomplete: 'name' })] : [];
  page('act-fields').replaceChildren(...[...made.fields ?? [], ...author].map((each) => element('p', each)));
  page('act').showModal();
  if (lostWords) showLost();
  anew();
  if (page('act-form').checkValidity()) foresee();
}

// Begin with the preview again: the answer to an earlier one is of other values.
function anew() {
  Object.assign(act, { preview: null, turn: {} });
  page('act-effect').replaceChildren();
  page('act-confirm').hidden = true;
  page('act-confirm').querySelector('input').required = false;
  Object.assign(page('act-go'), { textContent: act.title, disabled: true });
  say('');
}

const say = (text) => { page('act-said').textContent = text; };

function valuesOfDialog() {
  const inputs = [...page('act-fields').querySelectorAll('input, select')];
  return Object.fromEntries(inputs.map((each) => [each.name, each.type === 'checkbox' ? each.checked : each.type === 'number' ? each.valueAsNumber : each.value]));
}

// Show what the order would change.
async function foresee() {
  const mine = act;
  const turn = {};
  mine.turn = turn;
  const isMeant = () => act === mine && mine.turn === turn;
  const values = valuesOfDialog();
  if (values.author !== undefined) sessionStorage.setItem('author', values.author);
  let given;
  try {
    given = mine.arguments(values);
  } catch (error) {
    say(error.message);
    return;
  }
  if (mine.lines) {
    showPreview({ given, lines: mine.lines(), paths: mine.paths?.() });
    return;
  }
  const answer = await send({ order: mine.order, arguments: { ...given, preview: true } }, () => isMeant() && say(NO_ANSWER), isMeant);
  if (!isMeant()) return;
  if (answer?.success) showPreview({ given, lines: effectLines(answer), effect: answer.effect, cells: answer.cells });
  else if (answer) say(answer.message ?? answer.error);
}

function showPreview(preview) {
  act.preview = preview;
  page('act-effect').replaceChildren(...preview.lines.map((each) => element('li', each)));
  const asked = act.confirm?.(preview);
  page('act-confirm').hidden = asked === undefined;
  const typed = page('act-confirm').querySelector('input');
  Object.assign(typed, { required: asked !== undefined, value: '' });
  const name = typeof asked === 'number' ? 'number of cells' : 'name of the mission';
  page('act-confirm').querySelector('span').textContent = `type the ${name}, ${asked}, to go on`;
  page('act-go').disabled = false;
  (asked === undefined ? page('act-go') : typed).focus();
}

function effectLines({ message, effect, agents }) {
  const change = (name, [before, after], digits) => (before === null ? [] : [`${name}: ${digits(before)} → ${digits(after)}`]);
  const plain = (each) => String(Number(each.toFixed(2)));
  const named = (name, list) => (list.length ? [`${name}: ${list.join(', ')}`] : []);
  return [...(effect ? [
    ...change('the goal is free of hazards with', effect.p_free, share), ...change('hazards expected', effect.hazards, plain), ...change('robots lost', effect.lost, plain),
    ...named('would be held', effect.held.map(numbered)), ...named('out since before the change', effect.out.map(numbered)),
    ...(effect.seconds < 1 ? [] : [`takes ${effect.seconds.toFixed(0)} s`]),
  ] : [numbered(message)]), ...named('out, and not called back', agents ?? outNow())];
}

const outNow = () => board.robots.filter((each) => each.out).map((each) => each.name);
const outLine = () => `out, and not called back: ${outNow().join(', ') || 'nobody'}`;

// Give the order of the preview.
async function give() {
  const mine = act;
  const { given, effect, lines, paths } = mine.preview;
  if (mine.lines && JSON.stringify([mine.lines(), mine.paths?.()]) !== JSON.stringify([lines, paths])) {
    anew();
    foresee();
    if (mine.preview) say('This has changed since: look again. Nothing was ordered.');
    return;
  }
  const asked = mine.confirm?.(mine.preview);
  const typed = page('act-confirm').querySelector('input').value;
  const confirm = asked === undefined ? { confirm: paths } : { confirm: typeof asked === 'number' ? Number(typed) : typed };
  page('act-go').disabled = true;
  say('');
  const evidence = effect ? { epoch: effect.epoch, events: effect.events } : {};
  const answer = await send({ order: mine.order, arguments: { ...given, ...evidence }, ...confirm }, () => say(NO_ANSWER), () => act === mine);
  page('act-go').disabled = false;
  if (!answer || act !== mine) return;
  if (answer.success) {
    page('act').close();
    page('done').textContent = `${mine.title}: ${numbered(answer.message) || 'done'}`;
    return;
  }
  if (!effect) {
    say(answer.error ?? answer.message);
    return;
  }
  await foresee();
  if (act !== mine || !mine.preview) return;
  const now = mine.preview.effect;
  const isStale = now.events !== effect.events || !sameDeployment(now.epoch, effect.epoch);
  say(isStale ? 'The evidence has changed since the preview. Nothing was ordered: this is the preview of now.' : answer.error ?? answer.message);
}

// Send an order until it is answered, each time with the same nonce: it is obeyed once. `wait` is called before it is repeated.
async function send(what, wait, isWanted = () => true) {
  const nonce = crypto.randomUUID();
  if (what.arguments.preview) own.add(nonce);
  const body = JSON.stringify({ nonce, ...what });
  while (isWanted()) {
    try {
      const answer = await fetch('act', { method: 'POST', headers: { ...headersOf(), 'Content-Type': 'application/json' }, body, signal: AbortSignal.timeout(MAX_WAIT) });
      if (answer.status === 403) return { error: 'The command watch was started anew: open the address that it printed, and look whether the order was obeyed.' };
      if (answer.status !== 504) return await answer.json();
    } catch (error) {
      if (!(error instanceof TypeError || error instanceof DOMException)) throw error;
    }
    wait();
    await new Promise((resume) => { setTimeout(resume, AGAIN); });
  }
  return null;
}

async function stopAll() {
  const answer = await send({ order: 'hold', arguments: {} }, () => { page('done').textContent = 'HOLD has no answer so far: asking again.'; });
  page('done').textContent = `HOLD: ${answer.error ?? answer.message}`;
}

function proposeResume() {
  propose({
    title: 'Resume', order: 'resume', arguments: () => ({}), lines: () => [board.mission.reason, outLine()],
    warning: 'Robots depart again. A robot that has left cannot be called back.',
  });
}

function proposePlans(name) {
  propose({
    title: name === 'approve' ? 'Approve' : 'Refuse', order: name,
    arguments: () => {
      if (!proposals().length) throw new Error('Nothing waits for approval any more.');
      return {};
    },
    // The paths that are meant: others may wait by then.
    paths: () => Object.fromEntries(proposals().map(({ agent, cells }) => [agent, cells])),
    lines: () => proposals().map((each) => `${each.agent}: ${counted(each.cells.length - 1, 'step')}, returns with ${share(each.returns)}`),
    warning: name === 'approve' ? 'All robots of the round leave. They cannot be called back.' : 'Another round is proposed.',
  });
}

function proposeLoss(agent) {
  propose({
    title: `Give ${agent} up`, order: 'give_up', fields: [number('steps that it is known to have survived', 'steps_survived', 0, { min: 0, step: 1 })],
    arguments: ({ steps_survived }) => ({ agent, steps_survived }), lines: () => [`${agent} counts as lost`],
    warning: 'This cannot be taken back: only a return of the robot replaces the loss.',
  });
}

function proposeTakeBack(agent) {
  propose({
    title: `Take the order of ${agent} back`, order: 'take_back', isSigned: true, fields: [note()],
    arguments: ({ note: reason, author }) => ({ agent, reason, author }), lines: () => [`the order of ${agent} counts as never sent once its agent has refused it`],
    warning: 'A robot that has left by then stays out. Its agent gets the next order, unless departures are on hold.',
  });
}

function proposeEnd() {
  propose({
    title: 'End the mission', order: 'end_mission', arguments: () => ({}), lines: () => [outLine()], confirm: () => board.mission.name,
    warning: 'No robot departs any more. This cannot be undone.',
  });
}

function proposeParameter(name, before, after) {
  propose({
    title: `Set ${name}`, order: 'set', arguments: () => ({ name, value: after }), lines: () => [`${name}: ${before} → ${after}`],
    warning: 'It counts from the next plan or decision on.',
  });
}

// The cells that are meant, and a line on them.
function chosenCells() {
  if (!markedCells.size) throw new Error('No cell is marked: click on cells of the map, or type x and y.');
  return [...markedCells].sort((one, other) => one - other);
}

const meant = () => element('span', `${counted(markedCells.size, 'cell')}: ${[...markedCells].slice(0, 6).map(spot).join(', ')}${markedCells.size > 6 ? ', ...' : ''}`);

// What is known of the marked cells; `told` has the values to begin with.
function proposeFinding(title, told) {
  const said = { 0: 'nothing is said', 1: 'there is none', 2: 'there is one' };
  propose({
    title: `Say ${title}`, order: 'add_finding', isSigned: true, warning: 'It counts for all cells that are marked, and can be revoked.',
    fields: [
      meant(), choice('hazard', 'hazard', said, told.hazard ?? 0), choice('target', 'target', said, told.target ?? 0),
      number('confidence', 'confidence', 0.99, { min: 0, max: 0.999999 }),
      number('walked: a live hazard would have struck with', 'walked', told.walked ?? 0, { min: 0, max: 1 }),
      input('the field was changed: taken away, or placed', 'changed', { type: 'checkbox', checked: told.changed ?? false }),
      input('since (now if empty)', 'since', { type: 'datetime-local', step: 1 }), note(),
    ],
    arguments: ({ hazard, target, since, ...rest }) => ({
      finding: { cells: chosenCells(), ...rest, hazard: Number(hazard), target: Number(target), ...(since && { since: stampOf(since) }) },
    }),
    confirm: ({ given: { finding }, cells }) => (finding.hazard === 1 && finding.confidence > CLEARED ? cells : undefined),
  });
}

const stampOf = (local) => ({ sec: Math.round((new Date(local).getTime() + ahead) / 1000), nanosec: 0 });

function proposeNoGo(lift) {
  propose({
    title: lift ? 'Open again' : 'No-go', order: 'no_go', isSigned: true, fields: [meant(), note()],
    arguments: ({ note: reason, author }) => ({ cells: chosenCells(), lift, reason, author }),
    warning: lift ? 'Robots are sent into the marked cells again.' : 'No robot is sent into the marked cells any more. Robots that are out are not called back.',
  });
}

function proposeRevocation(said) {
  propose({
    title: 'Revoke', order: 'revoke', isSigned: true, fields: [element('span', `${said.author || 'somebody'}: ${statement(said)}`), note()],
    arguments: (values) => ({ revocation: { revokes: said.hash, ...values } }), warning: 'What was revoked can only be said anew.',
  });
}

// The deployments of the report, the newest first; one that it lacks so far stands before them.
function deploymentsKnown(given) {
  const known = Object.entries(mission?.deployments ?? {}).reverse().map(([place, { agent, stamp }]) => (
    { agent, deployment: stamp, name: `no. ${Number(place) + 1} of ${agent}` }));
  const isKnown = !given || known.some((each) => each.agent === given.agent && sameDeployment(each.deployment, given.deployment));
  return isKnown ? known : [{ ...given, name: `the last of ${given.agent}` }, ...known];
}

// Steps as a person types them: '3, 5-7'.
function stepsOf(text) {
  return text.split(',').filter((each) => each.trim()).flatMap((each) => {
    const ends = each.split('-').map(Number);
    if (ends.length > 2 || ends.some((step) => !Number.isInteger(step))) throw new Error(`'${each.trim()}' is no step, and no range of steps such as 3-7.`);
    return Array.from({ length: ends.at(-1) - ends[0] + 1 }, (_, place) => ends[0] + place);
  });
}

// What is known of a deployment; without a given one, of one that was lost.
function proposeAnnotation(given, kind) {
  const known = deploymentsKnown(given);
  const isLost = (place) => mission?.table.find((row) => row.deployment === Number(place))?.outcome === 'lost';
  const first = given ? known.findIndex((each) => each.agent === given.agent && sameDeployment(each.deployment, given.deployment))
    : Math.max(0, known.findIndex((each) => isLost(each.name.match(/[0-9]+/))));
  const [only] = markedCells.size === 1 ? markedCells : [];
  const hints = {
    1: `steps in which it may have been lost, such as 3-7; ${only === undefined ? 'mark one cell, or leave it empty for all' : `empty: where it entered ${spot(only)}`}`,
    2: 'number of steps that it survived; empty if it is not known', 3: 'steps that it entered, such as 1-7',
  };
  const kinds = choice('what', 'kind', KINDS, kind);
  const cause = choice('by', 'cause', { 0: 'it is not known', 1: 'a hazard', 2: 'something else' }, 0);
  const steps = input('', 'steps');
  const fit = () => {
    const chosen = kinds.querySelector('select').value;
    cause.hidden = Number(chosen) !== LOCATED;
    steps.hidden = !hints[chosen];
    steps.firstChild.textContent = `${hints[chosen] ?? ''} `;
  };
  kinds.addEventListener('change', fit);
  fit();
  propose({
    title: 'Say of a robot', order: 'annotate', isSigned: true, warning: 'It counts for the report by which the deployment stands, and can be revoked.',
    fields: [choice('deployment', 'place', Object.fromEntries(known.map((each, place) => [place, each.name])), first), kinds, cause, steps, note()],
    arguments: ({ place, kind: chosen, cause: by, steps: typed, ...rest }) => {
      if (!known[place]) throw new Error('No robot was sent so far.');
      const { agent, deployment } = known[place];
      const found = hints[chosen] ? stepsOf(typed) : [];
      const isAtCell = Number(chosen) === LOCATED && !found.length && only !== undefined;
      const survived = Number(chosen) === NO_HAZARD && !found.length ? [0] : found;
      return {
        annotation: { agent, deployment, kind: Number(chosen), cause: Number(chosen) === LOCATED ? Number(by) : 0, steps: survived, ...rest },
        ...(isAtCell && { cell: only }),
      };
    },
  });
}

// A sound, once the page was clicked or a key was pressed: browsers allow none before.
function beep() {
  if (!sound || page('mute').getAttribute('aria-pressed') === 'true') return;
  const [tone, volume] = [sound.createOscillator(), sound.createGain()];
  volume.gain.value = 0.2;
  tone.connect(volume).connect(sound.destination);
  tone.start();
  tone.stop(sound.currentTime + 0.3);
}

const headersOf = () => ({ 'X-Kbnitp-Token': sessionStorage.getItem('act') || sessionStorage.getItem('token') || '' });

function lose(why) {
  if (!lostWords) beep();
  const since = wordAt ? `, as of ${new Date(wordAt).toTimeString().slice(0, 8)}` : '';
  lostWords = `Connection lost${since}. ${why}`;
  showLost();
  document.title = lostWords;
}

// Above everything, the dialog too.
function showLost() {
  page('broken').querySelector('p').textContent = lostWords;
  page('broken').togglePopover(false);
  page('broken').togglePopover(true);
}

function heardAgain() {
  wordAt = Date.now();
  if (!lostWords) return;
  lostWords = '';
  page('broken').togglePopover(false);
  if (board) drawBoard();
}

async function followBoard() {
  document.documentElement.dataset.board = sessionStorage.getItem('act') ? 'act' : 'look';
  page('hold').className = 'act';
  showMarks();
  setInterval(tick, 1000);
  for (;;) {
    const control = new AbortController();
    let timer;
    const wait = () => {
      clearTimeout(timer);
      timer = setTimeout(() => control.abort(), SILENT);
    };
    try {
      wait();
      const answer = await fetch('board', { headers: headersOf(), signal: control.signal });
      if (answer.status === 403) {
        lose('This is not the address that the command watch has printed at its last start: open that one.');
        return;
      }
      ahead = Date.parse(answer.headers.get('Date')) - Date.now();
      for await (const text of answer.ok ? linesOf(answer) : []) {
        wait();
        heardAgain();
        if (text.startsWith('data: ')) {
          board = JSON.parse(text.slice(6));
          drawBoard();
        }
      }
    } catch (error) {
      if (!(error instanceof TypeError || error instanceof DOMException)) throw error;
    } finally {
      clearTimeout(timer);
    }
    lose('Trying again.');
    await new Promise((resume) => { setTimeout(resume, AGAIN); });
  }
}

const FINDINGS = {
  walked: ['it was walked', { walked: 0.9 }], cleared: ['a hazard was cleared', { hazard: 1, changed: true }],
  hazard: ['there is a hazard', { hazard: 2 }], target: ['there is a target', { target: 2 }],
};
Object.entries(FINDINGS).forEach(([id, told]) => page(`say-${id}`).addEventListener('click', () => proposeFinding(...told)));
page('say-wreck').addEventListener('click', () => proposeAnnotation(null, LOCATED));
page('no-go').addEventListener('click', () => proposeNoGo(false));
page('lift').addEventListener('click', () => proposeNoGo(true));
page('mark').addEventListener('click', switchMarking);
page('unmark').addEventListener('click', () => {
  markedCells.clear();
  showMarks();
});
page('end').addEventListener('click', proposeEnd);
page('mute').addEventListener('click', () => page('mute').setAttribute('aria-pressed', page('mute').getAttribute('aria-pressed') === 'false'));
document.addEventListener('pointerdown', ({ target, button }) => { heldDown = button === 0 ? target : null; });
// The click follows at once.
['pointerup', 'pointercancel'].forEach((name) => document.addEventListener(name, () => {
  heldDown = null;
  if (board) setTimeout(drawBoard);
}));
['pointerdown', 'keydown'].forEach((name) => document.addEventListener(name, () => { sound ??= board && new AudioContext(); }));
page('act-fields').addEventListener('input', anew);
page('act-cancel').addEventListener('click', () => page('act').close());
page('act').addEventListener('close', () => { act = null; });
page('act-form').addEventListener('submit', (event) => {
  event.preventDefault();
  // Enter in the field of the confirmation submits by the first button.
  const isConfirmed = page('act-confirm').contains(document.activeElement);
  if (act.preview && (event.submitter === page('act-go') || isConfirmed)) give();
  else foresee();
});
