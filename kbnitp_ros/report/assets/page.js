const NAMES = ['hazard', 'target', 'kappa'];

// Panels of curves: the names of their lines, and the keys of these lines in the facts.
const PANELS = {
  'entropy (nats)': {
    'H(Z) + H(X), all': 'entropy', 'H(Z), hazards': 'hazard_entropy', 'H(X), targets': 'target_entropy', 'H(Z, X), joint': 'joint_entropy',
  },
  'log loss (nats)': { 'hazard map': 'hazard_loss', 'target map': 'target_loss' },
  'information so far (nats)': { expected: 'expected', gained: 'gained' },
  robots: { lost: 'lost', out: 'out' },
};

// Columns of the tables, as `tableRow` reads them: texts have no decimals, and metres null.
const PLACE = [['x (m)', 'x', null], ['y (m)', 'y', null]];
const ON_EARTH = [['latitude (°)', 'latitude', 7], ['longitude (°)', 'longitude', 7]];
const COLUMNS = {
  findings: [['what', 'kind'], ...PLACE, ['probability', 'probability', 3], ['looks', 'looks', 0], ['target read', 'seen', 0]],
  safe: [...PLACE, ['hazard', 'hazard', 3], ['target', 'target', 3], ['lost by malfunctions', 'malfunctions', 2]],
  said: [['time', 'time'], ['who', 'author'], ['says', 'words'], ['of no.', 'number', 0], ['cells', 'count', 0], ['holds', 'holds'], ['note', 'note', undefined, true]],
  lost: [...PLACE, ['step', 'steps'], ['lost here', 'lost', 3]],
  deployments: [
    ['no.', 'deployment', 0], ['agent', 'agent', undefined, true], ['outcome', 'outcome'], ['steps', 'steps', 0],
    ['steps survived', 'steps_survived', 0, true], ['targets read', 'detected', 0], ['expected (nats)', 'information_expected', 2, true],
    ['gained (nats)', 'information_gained', 2, true], ['entropy (nats)', 'entropy', 1], ['log loss (nats)', 'log_loss', 1, true],
    ['reported after (s)', 'duration', 2, true],
  ],
};

// The facts of the mission, as facts.py describes them, and what follows from them.
let mission = null;
let frames;
let blocked;
let last = 0;
let panels = [];
let looks;
// What the reader chose: a moment, a cell, and the ends of a way. Paths are drawn once a moment is chosen.
let now = 0;
let cell = null;
let isAsked = false;
let isNamed = false;
// Coordinates that are typed stay as they are: the second one is still to come.
let isTyped = false;
let ends = [null, null];
let way = [];
let lost = [];
let timer = null;
// By the name of their boxes.
const maps = new Map();

const cells = () => mission.grid.width * mission.grid.height;
const level = (moment, name, each) => frames[(moment * NAMES.length + NAMES.indexOf(name)) * cells() + each];
const value = (moment, name, each) => (moment === last && mission.exact
  ? mission.exact[name][each] : level(moment, name, each) / 255);
const chosenColour = () => document.querySelector('[name=colour]:checked').value;
const isShown = (layer) => document.querySelector(`[name=layer][value=${layer}]`)?.checked;
const mayBeHazard = (moment, each) => value(moment, 'hazard', each) > mission.free;
// The centre of a cell as drawn, and (`position`) in the frame of the map: rows of a turned field are drawn to the right.
function center(each) {
  const { x, y, width, resolution } = mission.grid;
  return [x + ((each % width) + 0.5) * resolution, y + (Math.floor(each / width) + 0.5) * resolution];
}

function position(each) {
  const { corner, along, across, width } = mission.grid;
  return corner.map((begin, place) => begin + ((each % width) + 0.5) * along[place]
    + (Math.floor(each / width) + 0.5) * across[place]);
}

const spot = (each) => `(${position(each).map(metres).join(', ')})`;
// The cells of the field that satisfy a condition.
const those = (condition) => [...Array(cells()).keys()].filter((each) => !blocked.has(each) && condition(each));

// The values of all cells, in rows.
function inRows(of) {
  const { width, height } = mission.grid;
  return Array.from({ length: height }, (_, row) => Array.from({ length: width }, (__, column) => of(row * width + column)));
}

// Kappa is only shown where a hazard is possible.
function shownIn(moment, name, each) {
  if (blocked.has(each) || (name === 'kappa' && !mayBeHazard(moment, each))) return null;
  return mission.ends[name] ? mission.ends[name][each] : value(moment, name, each);
}

function told(moment, each) {
  if (blocked.has(each)) return `${spot(each)}: an obstacle, no robot can enter.`;
  const names = NAMES.filter((name) => shownIn(moment, name, each) !== null);
  const here = lost.find((loss) => loss.cell === each);
  const values = [...names.map((name) => [name, value(moment, name, each)]), ...(here ? [['this robot lost here', here.lost]] : [])];
  const [hazard, target] = mission.truth ? [mission.truth.hazard[each], mission.truth.target[each]] : [];
  const truth = mission.truth ? ` In truth ${hazard ? 'a hazard' : 'no hazard'}, ${target ? 'a target' : 'no target'}.` : '';
  const first = mission.visited[each];
  const visited = first >= 0 && first <= moment ? '' : ' No robot was sent here so far.';
  return `${spot(each)}: ${values.map(([name, number]) => `${name} ${number.toFixed(3)}`).join(', ')}.${truth}${visited}${lastLook(moment, each)}`;
}

// How old the last reading of a cell is, where targets may change.
function lastLook(moment, each) {
  if (!mission.looks) return '';
  const { place } = mission.moments[moment];
  const last = (mission.looks[each] || []).filter(([at]) => at <= place).at(-1);
  if (!last) return ' Its target was never read.';
  const age = place - last[0];
  return ` ${last[1] ? 'A target' : 'No target'} was read ${age ? `${age} deployment${age > 1 ? 's' : ''} ago` : 'just now'}; the probability is of now.`;
}

// The cells in which the robot of a moment may have been lost, the most probable first.
function losses(moment) {
  const { deployment } = mission.moments[moment];
  const { path, lost: shares } = isAsked && deployment !== null ? mission.deployments[deployment] : {};
  const found = new Map();
  (shares || []).forEach((share, step) => {
    const each = path[step + 1];
    const known = found.get(each) || { cell: each, steps: [], lost: 0 };
    found.set(each, { cell: each, steps: [...known.steps, step + 1], lost: known.lost + share });
  });
  return [...found.values()].sort((one, other) => other.lost - one.lost);
}

function line(paths) {
  const x = [];
  const y = [];
  for (const path of paths) {
    for (const each of path) {
      const [east, north] = center(each);
      x.push(east);
      y.push(north);
    }
    x.push(null);
    y.push(null);
  }
  return { x, y };
}

function overlays(moment) {
  const { deployment, survived, known, out } = mission.moments[moment];
  if (!isAsked || !isShown('paths')) return {};
  const traces = { out: line(out.map((each) => mission.deployments[each].path)) };
  const path = deployment === null ? [] : mission.moments[moment].walk || mission.deployments[deployment].path;
  const look = looks[survived ? 'returned' : 'lost'];
  traces.casing = line([path]);
  traces.walk = { ...line([path]), line: { width: 3, color: look.color, dash: look.dash } };
  const likely = mission.moments[moment].likely;
  traces.likely = line(likely ? [path.slice(likely[0], likely[1] + 1)] : []);
  const marked = { detected: [], nothing: [] };
  (mission.moments[moment].readings || []).forEach((reading, step) => {
    if (reading >= 0) marked[reading ? 'detected' : 'nothing'].push([path[step + 1]]);
  });
  traces.detected = line(marked.detected);
  traces.nothing = line(marked.nothing);
  const end = survived ? path.length - 1 : known;
  traces.end = {
    ...line(path.length && (survived || known) ? [[path[end]]] : []),
    marker: { symbol: look.symbol, size: 11, color: look.color, line: { color: 'white', width: 1 } },
  };
  return traces;
}

// A square in each cell, away from its borders, so that squares of neighbours do not merge.
function squares(found) {
  const half = 0.43 * mission.grid.resolution;
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]];
  const along = (axis) => found.flatMap((each) => [...corners.map((corner) => center(each)[axis] + half * corner[axis]), null]);
  return { x: along(0), y: along(1) };
}

// The marks of all cells, as large as cells allow.
function marks(moment) {
  const lined = (at, wide) => [[wide + 2.5, '#ffffff'], [wide, '#000000']].map(([width, color]) => scatter('lines', at, { line: { color, width } }));
  const marked = (name, found, share, marker) => scatter('markers', line(found.map((each) => [each])), { name, marker: { share, ...marker } });
  const green = '#00783c';
  const drawn = [];
  if (isShown('truth')) {
    drawn.push(...lined(squares(those((each) => mission.truth.hazard[each])), 1.5));
    const targets = those((each) => mission.truth.target[each]);
    drawn.push(marked('true target', targets, 0.9, { symbol: 'circle-open', line: { color: '#ffffff', width: 4 } }));
    drawn.push(marked('true target', targets, 0.9, { symbol: 'circle-open', line: { color: '#000000', width: 1.5 } }));
  }
  if (isShown('paths')) {
    const shares = lost.map((each) => 1.2 * Math.sqrt(each.lost));
    drawn.push(marked('lost', lost.map((each) => each.cell), shares.flatMap((each) => [each, 0]), { color: looks.lost.color, opacity: 0.85 }));
  }
  if (isShown('targets')) {
    const isProbable = (from, to) => those((each) => value(moment, 'target', each) >= from && value(moment, 'target', each) < to);
    const least = 3;
    drawn.push(marked('target', isProbable(0.5, 0.95), 0.5, { symbol: 'triangle-up', least, color: '#ffffff', line: { color: green, width: 1.5 } }));
    drawn.push(marked('found', isProbable(0.95, Infinity), 0.5, { symbol: 'triangle-up', least, color: green, line: { color: '#ffffff', width: 1 } }));
  }
  if (isShown('free')) {
    const free = those((each) => !mayBeHazard(moment, each));
    drawn.push(marked('free', free, 0.2, { color: '#000000', line: { color: '#ffffff', width: 1 } }));
  }
  if (isShown('said')) {
    Object.entries({ finding: ['square-open', 0.7, '#7b3294'], closed: ['x', 0.7, '#b00020'], wreck: ['diamond', 0.4, '#7b3294'] }).forEach(([mark, [symbol, share, color]]) => {
      const found = mission.said.filter((each) => each.mark === mark).flatMap((each) => each.cells);
      const edge = symbol.endsWith('-open') ? { color, width: 2 } : { color: '#ffffff', width: 1 };
      drawn.push(marked(mark, found, share, { symbol, color, least: 4, line: edge }));
    });
  }
  if (moment === last) drawn.push(...lined(line([mission.lane]), 2.5));
  drawn.push(...lined(line([way]), 2.5));
  return drawn;
}

const shape = (moment) => [{
  type: 'line', xref: 'x', yref: 'paper', x0: mission.moments[moment].place, x1: mission.moments[moment].place,
  y0: 0, y1: 1, line: { color: colours().text, width: 1 },
}];

// The cells in a colour.
function coloured(name) {
  const most = (mission.ends[name] || []).reduce((high, each) => Math.max(high, each), 1);
  const assumed = mission.assumed[name];
  return {
    z: inRows((each) => shownIn(now, name, each)),
    zmax: most,
    title: mission.colours[name],
    opacity: isShown('image') ? 0.6 : 1,
    colorscale: mission.scales[name][isDark() ? 'dark' : 'light'],
    // The scale of a probability shows the prior.
    ticks: [0, most, ...(assumed > 0.08 && assumed < 0.92 ? [assumed] : [])],
  };
}

// The path of a moment's robot, in the order of its traces on the map.
function walked() {
  const traces = overlays(now);
  const edge = { color: 'white', width: 1 };
  return [
    scatter('lines', traces.out, { line: { color: '#767676', width: 1, dash: 'dot' } }),
    scatter('lines', traces.casing, { line: { color: 'white', width: 6 } }),
    scatter('lines', traces.walk),
    scatter('markers', traces.detected, { marker: { symbol: 'diamond', size: 8, color: mission.series[2].color, line: edge } }),
    scatter('markers', traces.nothing, { marker: { symbol: 'circle-open', size: 6, color: '#767676' } }),
    scatter('markers', traces.end),
    scatter('lines', traces.likely, { line: { color: looks.lost.color, width: 9 }, opacity: 0.5 }),
  ];
}

// What all maps of a moment share: rows of a turned field are drawn to the right.
function layout() {
  const { grid } = mission;
  const turned = grid.yaw ? { x: -grid.yaw, y: Math.PI / 2 - grid.yaw } : {};
  return {
    grid,
    obstacles: blocked,
    labels: grid.yaw ? ['along the rows (m)', 'across the rows (m)'] : ['x (m)', 'y (m)'],
    arrows: Object.entries({ ...turned, ...(grid.north !== null && { N: grid.north - grid.yaw }) }),
    // Under translucent cells.
    image: isShown('image') ? mission.site : null,
    unvisited: new Set(those((each) => mission.visited[each] < 0 || mission.visited[each] > now)),
    marked: markedCells,
    frame: isNamed ? cell : null,
  };
}

function drawMap() {
  const bases = scatter('markers', line(mission.grid.bases.map((each) => [each])), {
    name: 'base', marker: { symbol: 'pentagon', size: 12, color: '#ffffff', line: { color: '#000000', width: 2 } },
  });
  page('map').setAttribute('aria-label', `Map: ${mission.colours[chosenColour()]}; ${page('told').textContent}`);
  maps.get('map').draw([coloured(chosenColour()), ...walked(), bases, ...marks(now), ...boardMarks()], layout());
  Object.keys(mission.colours).forEach((each) => maps.get(`small-${each}`).draw([coloured(each), bases], layout()));
}

function drawCell() {
  const places = mission.moments.map((moment) => moment.place);
  const { data, layout } = panel('', NAMES.map((name, place) => curve(
    places, places.map((_, moment) => shownIn(moment, name, cell)), name, mission.series[place],
  )), { height: 220, range: [0, 1.02] });
  Plotly.react(page('cell-plot'), data, { ...themed(layout), shapes: shape(now) }, config);
  if (!isTyped) [page('x').value, page('y').value] = position(cell).map(metres);
  page('cell').textContent = told(now, cell);
}

function drawCurves() {
  panels.forEach(({ data, layout }, place) => {
    Plotly.react(page(`curve-${place}`), data, { ...themed(layout), shapes: shape(now) }, config);
  });
}

function tell() {
  const moment = mission.moments[now];
  page('told').textContent = isAsked ? moment.told : 'After the last report. The slider, the arrow keys and Play show earlier moments.';
  page('moment').value = now;
  page('moment').setAttribute('aria-valuetext', page('told').textContent);
  page('deployment').replaceChildren(...moment.facts.flatMap(([term, text]) => [element('dt', term), element('dd', text)]));
  lost = losses(now);
  page('loss').hidden = !lost.length;
  fill(page('lost'), COLUMNS.lost, lost.map((loss) => {
    const [x, y] = position(loss.cell);
    return tableRow(COLUMNS.lost, { ...loss, x, y, steps: loss.steps.join(', ') }, true);
  }));
  markRow(moment.deployment);
}

// Mark the row of a deployment, and scroll to it in the table only.
function markRow(deployment) {
  document.querySelectorAll('#deployments tr[aria-current]').forEach((row) => row.removeAttribute('aria-current'));
  const row = page(`deployment-${deployment}`);
  if (!row) return;
  row.setAttribute('aria-current', 'true');
  const box = row.closest('.wide');
  const head = box.querySelector('thead').offsetHeight;
  if (row.offsetTop < box.scrollTop + head) box.scrollTop = row.offsetTop - head;
  const below = row.offsetTop + row.offsetHeight - box.clientHeight;
  if (box.scrollTop < below) box.scrollTop = below;
}

function ask(moment) {
  isAsked = true;
  show(moment);
}

function show(moment) {
  now = Math.max(0, Math.min(last, moment));
  tell();
  drawMap();
  drawCell();
  panels.forEach((_, place) => Plotly.relayout(page(`curve-${place}`), { shapes: shape(now) }));
  document.documentElement.dataset.moment = now;
}

function stop() {
  clearInterval(timer);
  timer = null;
  page('play').textContent = 'Play';
  page('play').setAttribute('aria-pressed', 'false');
  page('told').setAttribute('role', 'status');
}

function play() {
  if (timer !== null) {
    stop();
    return;
  }
  if (now === last) ask(0);
  page('play').textContent = 'Pause';
  page('play').setAttribute('aria-pressed', 'true');
  // Too fast for screen readers.
  page('told').removeAttribute('role');
  timer = setInterval(() => (now === last ? stop() : ask(now + 1)), Math.max(80, Math.min(700, 40000 / (last + 1))));
}

let isDue = false;
function look(each, typed = false) {
  cell = each;
  isTyped = typed;
  isNamed = true;
  markChosen(cell);
  maps.forEach((map) => map.choose(cell));
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => {
    isDue = false;
    drawCell();
  });
}

// Choose the cell at the typed coordinates; return whether it is in the field.
function named() {
  const { corner, along, across, resolution, width, height } = mission.grid;
  const [x, y] = ['x', 'y'].map((id, place) => Number(page(id).value) - corner[place]);
  const [column, row] = [along, across].map((axis) => Math.floor((x * axis[0] + y * axis[1]) / resolution ** 2));
  const isInside = column >= 0 && column < width && row >= 0 && row < height;
  if (isInside) look(row * width + column, true);
  else page('cell').textContent = `(${page('x').value}, ${page('y').value}) is not in the field.`;
  return isInside;
}

// Longitude and latitude, as in RFC 7946; without a datum, metres in the frame of the map, which the file states.
function geojson(features) {
  const frame = mission.isOnEarth ? {} : { frame: 'map', unit: 'm' };
  return JSON.stringify({
    type: 'FeatureCollection', name: mission.name, ...frame,
    features: features.map(([type, coordinates, properties]) => ({ type: 'Feature', geometry: { type, coordinates }, properties })),
  }, null, 1);
}

// The rows of a table in its present order: polygons if they have corners.
function rowFeatures(id) {
  return [...page(id).tBodies[0].rows].map(({ values }) => {
    const place = mission.isOnEarth ? [values.longitude, values.latitude] : [values.x, values.y];
    const properties = Object.fromEntries(columnsOf(id).map(([heading, key]) => [heading, values[key]]));
    return [...(values.corners ? ['Polygon', [values.corners]] : ['Point', place]), properties];
  });
}

function columnsOf(id) {
  const isKnown = ([, key]) => key !== 'log_loss' || mission.truth;
  return [...COLUMNS[id].filter(isKnown), ...(mission.isOnEarth && id !== 'deployments' ? ON_EARTH : [])];
}

// Find the way on which core's `safest_ways` reached the cell, and tell its probabilities.
function findWay() {
  const [from, to] = [ends[0] ?? mission.grid.bases[0], ends[1]];
  const before = mission.ways[from];
  const isBlocked = blocked.has(from) || blocked.has(to);
  way = [];
  if (to !== null && !isBlocked && before && (to === from || before[to] >= 0)) {
    way = [to];
    while (way[0] !== from) way.unshift(before[way[0]]);
  }
  document.querySelector('[data-take="way.geojson"]').disabled = !way.length;
  const between = `from ${spot(from)} to ${to === null ? 'a cell that is not chosen yet' : spot(to)}`;
  if (way.length) {
    const hazard = way.map((each) => mission.exact.hazard[each]);
    const free = hazard.reduce((product, each) => product * (1 - each), 1);
    const [safe, deadly] = mission.survival;
    const survived = hazard.slice(1).reduce((product, each) => product * (safe * (1 - each) + deadly * each), 1);
    const percent = (each) => `${(100 * each).toFixed(1)} %`;
    page('way').textContent = `The safest way ${between} has ${way.length - 1} steps. It is free of hazards with ${percent(free)}; `
      + `a robot survives it with ${percent(survived)}. ${hazard.reduce((sum, each) => sum + each, 0).toFixed(2)} hazards are expected on it.`;
  } else {
    const why = isBlocked ? 'an obstacle is in one of the two cells' : before ? 'obstacles are between the two cells' : 'in so large a field ways begin at a base';
    page('way').textContent = `No way ${between}${to === null && before ? '' : `: ${why}`}.`;
  }
}

function wayEnds(place) {
  ends[place] = cell;
  findWay();
  drawMap();
}

function take(file) {
  const [id, format] = file.split('.');
  const places = () => way.map((each) => (mission.earth ? mission.earth[each] : position(each)));
  const features = () => (id === 'way' ? [['LineString', places(), { steps: way.length - 1 }]] : rowFeatures(id));
  const [type, text] = format === 'csv' ? ['text/csv', csv(page(id))] : ['application/geo+json', geojson(features())];
  keep(`${mission.name}_${file}`, type, text);
}

function pressed(event) {
  // Numbers, the slider and tables that scroll sideways use arrow keys themselves.
  const box = event.target.closest('input, .wide');
  if (!mission || event.altKey || event.ctrlKey || event.metaKey || (box && (box.tagName === 'INPUT' || box.scrollWidth > box.clientWidth))) return;
  const to = { ArrowLeft: now - 1, ArrowRight: now + 1 }[event.key];
  if (to === undefined) return;
  event.preventDefault();
  ask(to);
}

function paint() {
  page('theme').textContent = isDark() ? 'Light' : 'Dark';
  if (!mission) return;
  drawCurves();
  show(now);
}

// Make parts anew if their names have changed, so that choices in them stay.
function renew(id, names, parts) {
  const named = names.join('\n');
  if (page(id).dataset.names === named) return;
  page(id).dataset.names = named;
  page(id).querySelectorAll('.js-plotly-plot').forEach(Plotly.purge);
  page(id).querySelectorAll(':scope > :not(legend)').forEach((each) => each.remove());
  page(id).append(...parts());
}

const field = (type, name, value, attributes) => element(
  'label', [element('input', [], { type, name, value, ...attributes }), ` ${value.replaceAll('-', ' ')}`],
);

// A figure with a button that saves it; `told` is for screen readers.
function figure(id, caption, what, told) {
  const button = element('button', 'PNG', { type: 'button', className: 'save', ariaLabel: `Save the ${what} as PNG` });
  button.dataset.plot = id;
  const plot = element('div', [], { id, className: 'plot', role: 'img', ariaLabel: told });
  return element('figure', caption ? [element('figcaption', [caption, ' ', button]), plot] : [button, plot]);
}

// The panels of curves: of the mission, and of the numbers that it learns.
function allPanels() {
  const { curves, learnt, series } = mission;
  const places = mission.moments.map((moment) => moment.place);
  const known = Object.entries(PANELS).filter(([, lines]) => Object.values(lines).every((key) => curves[key]));
  const thin = { color: '#888888', width: 1 };
  return [
    ...known.map(([label, lines]) => panel(label, Object.entries(lines).map(([name, key], place) => (
      curve(places, curves[key], name, series[place]))))),
    ...Object.entries(learnt).map(([name, { low, middle, high, truth }]) => panel(name.replaceAll('_', ' '), [
      curve(places, low, '5 %', thin, { showlegend: false }),
      curve(places, high, '5 to 95 %', thin, { fill: 'tonexty', fillcolor: 'rgba(136,136,136,0.3)' }),
      curve(places, middle, 'median', { color: series[0].color }),
      ...(truth === null ? [] : [curve(places, places.map(() => truth), 'truth', series[1])]),
    ], { range: [0, 1] })),
  ];
}

// Write what is said of the last moment: the answers, the tables and the configuration.
function write() {
  const { grid, colours: shown, truth } = mission;
  page('summary').textContent = mission.summary;
  page('notes').replaceChildren(...mission.notes.map((each) => element('p', each, { className: 'note' })));
  page('answers').replaceChildren(...mission.tiles.map(([question, answer, detail, link]) => element('article', [
    element('h3', link ? element('a', question, { href: `#${link}` }) : question), element('p', answer), element('p', detail),
  ])));
  renew('colours', Object.keys(shown), () => Object.keys(shown).map((name, place) => (
    field('radio', 'colour', name, { id: `colour-${name}`, checked: !place }))));
  const layers = ['targets', 'free', 'paths', ...(truth ? ['truth'] : []), ...(mission.said.length ? ['said'] : []), ...(mission.site ? ['image'] : [])];
  renew('layers', layers, () => layers.map((name) => field('checkbox', 'layer', name, { checked: true })));
  renew('maps', Object.keys(shown), () => Object.entries(shown).map(([name, words]) => (
    figure(`small-${name}`, words, `map of ${words}`, `Map of ${words}`))));
  ['map', ...Object.keys(shown).map((name) => `small-${name}`)].forEach(addMap);
  renew('curves', panels.map(({ label }) => label), () => panels.map(({ label }, place) => (
    figure(`curve-${place}`, '', `curves of ${label}`, `Curves of ${label}, report after report; the table of deployments has the numbers`))));
  document.querySelectorAll('.truth').forEach((each) => { each.hidden = !truth; });
  document.querySelectorAll('.said').forEach((each) => { each.hidden = !mission.said.length; });
  fill(page('said'), COLUMNS.said, mission.said.map((row) => tableRow(COLUMNS.said, row, 'cell' in row)));
  page('ways').hidden = !mission.exact;
  ['findings', 'safe'].forEach((id) => fill(page(id), columnsOf(id), mission[id].map((row) => tableRow(columnsOf(id), row, true))));
  fill(page('deployments'), columnsOf('deployments'), mission.table.map((row) => (
    Object.assign(tableRow(columnsOf('deployments'), row, row.moment !== null), { id: `deployment-${row.deployment - 1}` }))));
  const settings = Object.entries(mission.configuration);
  renew('configuration', [JSON.stringify(settings)], () => (settings.length ? settings.map(configured)
    : [element('p', 'The log does not say how the run was configured.')]));
  page('map').style.setProperty('--width', grid.width);
  page('map').style.setProperty('--height', grid.height);
  page('moment').max = last;
  if (!grid.along[1]) {
    // The arrows of the fields x and y go from cell to cell.
    position(0).forEach((least, place) => Object.assign(page('xy'[place]), { min: metres(least), step: grid.resolution }));
  }
}

// Make the map of a box, unless it has one.
function addMap(id) {
  if (maps.get(id)?.box !== page(id)) maps.set(id, new FieldMap(page(id), look, (each) => told(now, each), id !== 'map'));
}

function configured([name, values]) {
  const columns = [['name', 'name'], ['value', 'value']];
  const table = element('table', [element('thead', element('tr')), element('tbody')]);
  fill(table, columns, Object.entries(values).map(([key, text]) => tableRow(columns, { name: key, value: text })));
  return element('details', [element('summary', name), element('div', table, { className: 'wide', tabIndex: 0, role: 'group', ariaLabel: name })]);
}

function onClick(plot, act) {
  page(plot).removeAllListeners('plotly_click');
  page(plot).on('plotly_click', act);
}

// Show the facts of a mission: at first, and whenever its log has grown.
async function load(text) {
  document.querySelector('main').hidden = !text;
  if (!text) return;
  const told = JSON.parse(text);
  const facts = { ...told, ...await (await unpacked(told.packed, 'deflate')).json() };
  const levels = new Uint8Array(await (await unpacked(facts.frames, 'deflate')).arrayBuffer());
  if (!window.Plotly) {
    const code = await (await unpacked(page('plotly').textContent, 'gzip')).text();
    document.head.append(element('script', code));
  }
  const isAtEnd = now === last;
  [mission, frames] = [facts, levels];
  const size = NAMES.length * cells();
  for (let place = size; place < frames.length; place += 1) frames[place] += frames[place - size];
  blocked = new Set(mission.grid.blocked);
  // A turned field is drawn from (0, 0), without its rotation.
  [mission.grid.x, mission.grid.y] = mission.grid.yaw ? [0, 0] : mission.grid.corner;
  last = mission.moments.length - 1;
  now = isAtEnd ? last : Math.min(now, last);
  if (!isNamed || cell >= cells()) [cell, isNamed, ends] = [mission.cell, false, [null, null]];
  const [returned, destroyed] = mission.series;
  looks = { returned: { ...returned, symbol: 'circle' }, lost: { ...destroyed, symbol: 'x' } };
  panels = allPanels();
  write();
  if (ends[1] !== null) findWay();
  paint();
  panels.forEach((_, place) => onClick(`curve-${place}`, ({ points: [{ x }] }) => ask(mission.moments.findIndex((moment) => moment.place >= x))));
  document.documentElement.dataset.ready = 'true';
}

// Take the tokens to look and to act out of the address; a reload finds them again.
function tokenOfServer() {
  const given = new URLSearchParams(location.hash.slice(1));
  if (given.has('token')) {
    sessionStorage.setItem('token', given.get('token'));
    sessionStorage.setItem('act', given.get('act') ?? '');
    history.replaceState(null, '', location.pathname);
  }
  return sessionStorage.getItem('token') ?? '';
}

// Yield the lines of an answer as they arrive.
async function* linesOf(answer) {
  let text = '';
  for await (const part of chunks(answer.body.pipeThrough(new TextDecoderStream()).getReader())) {
    const lines = (text + part).split('\n');
    text = lines.pop();
    yield* lines.filter(Boolean);
  }
}

// Only newer browsers iterate over streams.
async function* chunks(reader) {
  for (let part = await reader.read(); !part.done; part = await reader.read()) yield part.value;
}

// Follow the log of a running mission.
async function follow() {
  const headers = { 'X-Kbnitp-Token': tokenOfServer() };
  const say = (text) => { page('live').textContent = text; };
  let shown = 0;
  page('live').hidden = false;
  for (;;) {
    try {
      const events = await fetch('events', { headers });
      if (events.status === 403) {
        say('This is not the address that the command watch has printed at its last start: open that one.');
        return;
      }
      for await (const line of events.ok ? linesOf(events) : []) {
        const { told, version } = JSON.parse(line);
        say(told);
        if (version !== shown) {
          const facts = await fetch('facts', { headers });
          if (facts.ok) {
            shown = version;
            await attempt(async () => load(await facts.text()));
          }
        }
      }
    } catch (error) {
      if (!(error instanceof TypeError)) throw error;
    }
    say('The command watch has ended, so the page no longer changes.');
    await new Promise((resume) => { setTimeout(resume, 2000); });
  }
}

async function attempt(work) {
  try {
    await work();
  } catch (error) {
    page('trouble').hidden = false;
    page('trouble').textContent = `The page cannot be shown here: ${error.message}. It needs a browser of 2023 or later.`;
    throw error;
  }
}

function clicked({ target }) {
  const { plot, take: file, magnify } = target.dataset;
  if (magnify) maps.get('map').magnify(Number(magnify));
  if (maps.has(plot)) maps.get(plot).save(`${mission.name}_${plot}.png`);
  else if (plot) Plotly.downloadImage(page(plot), { format: 'png', scale: 3, filename: `${mission.name}_${plot}` });
  if (file) take(file);
  if (target.matches('th button')) sort(target.parentNode);
  const { values } = target.closest('tbody tr') || {};
  if (values?.cell !== undefined) look(values.cell);
  else if (Number.isInteger(values?.moment)) ask(values.moment);
  if (target.matches('#answers a[href^="#colour-"]')) page(target.hash.slice(1)).click();
}

page('moment').addEventListener('input', (event) => ask(Number(event.target.value)));
page('previous').addEventListener('click', () => ask(now - 1));
page('next').addEventListener('click', () => ask(now + 1));
page('play').addEventListener('click', play);
page('way-from').addEventListener('click', () => wayEnds(0));
page('way-to').addEventListener('click', () => wayEnds(1));
['x', 'y'].forEach((id) => page(id).addEventListener('change', named));
page('go').addEventListener('click', goToCell);
['colours', 'layers'].forEach((id) => page(id).addEventListener('change', drawMap));
page('theme').addEventListener('click', () => {
  document.documentElement.dataset.theme = isDark() ? 'light' : 'dark';
  paint();
});
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', paint);
document.addEventListener('keydown', pressed);
document.addEventListener('click', clicked);
// A sheet of A4 is 700 pixels wide between its margins.
window.addEventListener('beforeprint', () => maps.get('map')?.render(640, 440, 2));
window.addEventListener('afterprint', () => maps.get('map')?.render());

const written = page('facts').textContent.trim();
if (written) attempt(() => load(written));
else {
  follow();
  if (document.documentElement.dataset.board) followBoard();
}
