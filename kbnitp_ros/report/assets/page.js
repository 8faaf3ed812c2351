// Unpack what page.py has packed.
async function unpacked(id, format = 'deflate') {
  const text = document.getElementById(id).textContent.trim();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream(format));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const NAMES = ['hazard', 'target', 'kappa'];
const LISTS = ['deployments', 'findings', 'safe'];

// Draw the page; return a function that returns the view. `signal` ends listeners outside of replaced parts.
async function start(signal, kept, main) {
  const mission = JSON.parse(new TextDecoder().decode(await unpacked('mission')));
  const frames = await unpacked('frames');
  if (!window.Plotly) {
    const code = new TextDecoder().decode(await unpacked('plotly', 'gzip'));
    document.head.append(Object.assign(document.createElement('script'), { textContent: code }));
  }
  // Newer parts have arrived.
  if (signal.aborted) return view;
  const plots = JSON.parse(page('plots').textContent);
  // From here on nothing is awaited, so that the page is never shown half drawn.
  if (main) {
    document.querySelectorAll('.js-plotly-plot').forEach(Plotly.purge);
    const open = [...document.querySelectorAll('details[open] > summary')].map((each) => each.textContent);
    main.querySelectorAll('details').forEach((each) => { each.open = open.includes(each.firstChild.textContent); });
    document.querySelector('main').replaceWith(main);
  }
  const CURVES = Object.keys(plots).filter((id) => id.startsWith('curve-'));
  const SMALL = Object.keys(mission.colours).map((name) => `small-${name}`);
  const { width, height } = mission.grid;
  const cells = width * height;
  const size = NAMES.length * cells;
  for (let place = size; place < frames.length; place += 1) frames[place] += frames[place - size];
  const blocked = new Set(mission.grid.blocked);
  const last = mission.moments.length - 1;
  let now = last;
  let timer = null;
  let cell = mission.cell;
  // Coordinates that are typed stay as they are: the second one is still to come.
  let isTyped = false;
  // The page opens with the last belief; paths are drawn once a moment is chosen.
  let isAsked = false;
  let isNamed = false;
  // The ends of the safest way.
  let ends = [mission.grid.bases[0], null];
  let way = [];
  let lost = [];
  const layers = [...document.querySelectorAll('[name=layer]')];
  if (kept) {
    ({ cell, isAsked, isNamed, ends } = kept);
    page(kept.colour).checked = true;
    layers.forEach((layer) => { layer.checked = kept.shown.includes(layer.value); });
    now = kept.moment === null ? last : Math.min(kept.moment, last);
  }

  const level = (moment, name, each) => frames[moment * size + NAMES.indexOf(name) * cells + each];
  const value = (moment, name, each) => (moment === last && mission.exact
    ? mission.exact[name][each] : level(moment, name, each) / 255);
  const colourId = () => document.querySelector('[name=colour]:checked').id;
  const isShown = (layer) => layers.some((each) => each.value === layer && each.checked);
  const mayBeHazard = (moment, each) => value(moment, 'hazard', each) > mission.free;
  // The centre of a cell as drawn, and (`position`) in the frame of the map: rows of a turned field are drawn to the right.
  const center = (each) => [
    mission.grid.x + (each % width + 0.5) * mission.grid.resolution,
    mission.grid.y + (Math.floor(each / width) + 0.5) * mission.grid.resolution,
  ];

  function position(each) {
    const { corner, along, across } = mission.grid;
    return corner.map((begin, place) => begin + (each % width + 0.5) * along[place]
      + (Math.floor(each / width) + 0.5) * across[place]);
  }

  const metres = (number) => String(Number(number.toFixed(3)) + 0);
  const spot = (each) => `(${position(each).map(metres).join(', ')})`;
  // The cells of the field that satisfy a condition.
  const those = (condition) => [...Array(cells).keys()].filter((each) => !blocked.has(each) && condition(each));

  // The values of all cells, in rows.
  function inRows(of) {
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
    return `${spot(each)}: ${values.map(([name, number]) => `${name} ${number.toFixed(3)}`).join(', ')}.${truth}${visited}`;
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

  // The image of the map, under translucent cells.
  const site = () => (isShown('image') ? [{
    source: mission.site.source, xref: 'x', yref: 'y', sizing: 'stretch', layer: 'below',
    x: mission.grid.x, y: mission.grid.y + mission.site.height,
    sizex: mission.site.width, sizey: mission.site.height,
  }] : []);

  function overlays(moment) {
    const { deployment, survived, known, out } = mission.moments[moment];
    if (!isAsked || !isShown('paths')) return {};
    const traces = { out: line(out.map((each) => mission.deployments[each].path)) };
    const path = deployment === null ? [] : mission.moments[moment].walk || mission.deployments[deployment].path;
    const look = mission.walks[survived ? 'returned' : 'lost'];
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
    const side = Math.min(24, (page('map').clientWidth - 100) / width);
    const lined = (at, wide) => [[wide + 2.5, '#ffffff'], [wide, '#000000']].map(([size, color]) => (
      { type: 'scatter', mode: 'lines', hoverinfo: 'skip', cliponaxis: false, ...at, line: { color, width: size } }));
    const marked = (name, found, size, marker) => ({
      type: 'scatter', mode: 'markers', hoverinfo: 'skip', name, ...line(found.map((each) => [each])), marker: { size, ...marker },
    });
    const green = '#00783c';
    const drawn = [];
    if (isShown('truth')) {
      drawn.push(...lined(squares(those((each) => mission.truth.hazard[each])), 1.5));
      const targets = those((each) => mission.truth.target[each]);
      drawn.push(marked('true target', targets, 0.9 * side, { symbol: 'circle-open', color: '#ffffff', line: { width: 4 } }));
      drawn.push(marked('true target', targets, 0.9 * side, { symbol: 'circle-open', color: '#000000', line: { width: 1.5 } }));
    }
    if (isShown('paths')) {
      const size = lost.map((each) => 1.2 * side * Math.sqrt(each.lost));
      drawn.push(marked('lost', lost.map((each) => each.cell), size.flatMap((each) => [each, 0]), { color: mission.walks.lost.color, opacity: 0.85 }));
    }
    if (isShown('targets')) {
      const isProbable = (from, to) => those((each) => value(moment, 'target', each) >= from && value(moment, 'target', each) < to);
      drawn.push(marked('target', isProbable(0.5, 0.95), 0.5 * side, { symbol: 'triangle-up', color: '#ffffff', line: { color: green, width: 1.5 } }));
      drawn.push(marked('found', isProbable(0.95, Infinity), 0.5 * side, { symbol: 'triangle-up', color: green, line: { color: '#ffffff', width: 1 } }));
    }
    if (isShown('free')) {
      const free = those((each) => !mayBeHazard(moment, each));
      drawn.push(marked('free', free, Math.max(2, side / 5), { color: '#000000', line: { color: '#ffffff', width: 1 } }));
    }
    if (moment === last) drawn.push(...lined(line([mission.lane]), 2.5));
    drawn.push(...lined(line([way]), 2.5));
    return drawn;
  }

  const shape = (moment) => [{
    type: 'line', xref: 'x', yref: 'paper', x0: mission.moments[moment].place, x1: mission.moments[moment].place,
    y0: 0, y1: 1, line: { color: colours().text, width: 1 },
  }];

  // A frame around the chosen cell: black within white, for light and dark maps.
  function frame() {
    const [x, y] = center(cell);
    const half = mission.grid.resolution / 2;
    if (!isNamed) return [];
    return [['#ffffff', 5], ['#000000', 2]].map(([color, wide]) => ({
      type: 'rect', xref: 'x', yref: 'y', x0: x - half, x1: x + half, y0: y - half, y1: y + half,
      line: { color, width: wide },
    }));
  }

  // The cells in a colour, with a text for each.
  function coloured(name, text, bar) {
    const shown = {
      ...plots.map.data[0],
      z: inRows((each) => shownIn(now, name, each)),
      zmax: (mission.ends[name] || []).reduce((most, each) => Math.max(most, each), 1),
      text,
      hovertemplate: '%{text}<extra></extra>',
      hoverongaps: true,
      colorbar: { thickness: 10, len: 0.9, ...bar },
    };
    colour(shown, mission.scales[name], mission.assumed[name]);
    return shown;
  }

  function drawMap() {
    const images = [
      ...site(), ...hatching(mission.grid, mission.visited.map((first) => first >= 0 && first <= now)),
    ];
    const name = colourId().replace('colour-', '');
    const words = mission.colours[name];
    const layout = { ...themed(plots.map.layout), images, shapes: frame() };
    const traces = overlays(now);
    const data = plots.map.data.slice(1);
    mission.traces.slice(1).forEach((trace, place) => Object.assign(data[place], traces[trace] || { x: [], y: [] }));
    // On a narrow phone the colour bar is below the map.
    const bar = page('map').clientWidth < 500 ? { orientation: 'h', y: -0.15, yanchor: 'top', title: { text: words, side: 'bottom' } }
      : { title: { text: words, side: 'right' } };
    page('map').setAttribute('aria-label', `Map: ${words}; ${page('told').textContent}`);
    const texts = inRows((each) => told(now, each));
    const draw = (id, drawn) => {
      drawn.filter((trace) => trace.type === 'heatmap').forEach((trace) => { trace.opacity = isShown('image') ? 0.6 : 1; });
      Plotly.react(page(id), drawn, layout, config);
    };
    draw('map', [coloured(name, texts, bar), ...data, ...marks(now)]);
    Object.keys(mission.colours).forEach((each) => draw(`small-${each}`, [coloured(each, texts), ...plots.map.data.slice(mission.traces.length)]));
  }

  function drawCell() {
    const places = mission.moments.map((moment) => moment.place);
    NAMES.forEach((name, place) => {
      plots.cell.data[place].x = places;
      plots.cell.data[place].y = places.map((_, moment) => shownIn(moment, name, cell));
    });
    Plotly.react(page('cell-plot'), plots.cell.data, { ...themed(plots.cell.layout), shapes: shape(now) }, config);
    if (!isTyped) [page('x').value, page('y').value] = position(cell).map(metres);
    page('cell').textContent = told(now, cell);
  }

  function drawCurves() {
    CURVES.forEach((id) => {
      Plotly.react(page(id), plots[id].data, { ...themed(plots[id].layout), shapes: shape(now) }, config);
    });
  }

  function tell() {
    const moment = mission.moments[now];
    page('told').textContent = isAsked ? moment.told : 'After the last report. The slider, the arrow keys and Play show earlier moments.';
    page('moment').value = now;
    page('moment').setAttribute('aria-valuetext', page('told').textContent);
    const list = page('deployment');
    list.replaceChildren();
    for (const [term, value] of moment.facts) {
      list.append(Object.assign(document.createElement('dt'), { textContent: term }));
      list.append(Object.assign(document.createElement('dd'), { textContent: value }));
    }
    lost = losses(now);
    page('loss').hidden = !lost.length;
    page('lost').tBodies[0].replaceChildren(...lost.map((loss) => {
      const row = document.createElement('tr');
      row.dataset.cell = loss.cell;
      const [x, y] = position(loss.cell);
      [[x, metres(x)], [y, metres(y)], [loss.steps.join(', ')], [loss.lost, loss.lost.toFixed(3)]].forEach(([exact, text], place) => {
        const field = row.insertCell();
        field.dataset.value = exact;
        const shown = place ? field : field.appendChild(document.createElement('button'));
        shown.textContent = text ?? exact;
      });
      return row;
    }));
    document.querySelectorAll('#deployments tr[aria-current]').forEach((row) => row.removeAttribute('aria-current'));
    const row = moment.deployment === null ? null : page(`deployment-${moment.deployment}`);
    if (row) {
      row.setAttribute('aria-current', 'true');
      // Scroll the table only, and not the page.
      const box = row.closest('.wide');
      const head = box.querySelector('thead').offsetHeight;
      if (row.offsetTop < box.scrollTop + head) box.scrollTop = row.offsetTop - head;
      const below = row.offsetTop + row.offsetHeight - box.clientHeight;
      if (box.scrollTop < below) box.scrollTop = below;
    }
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
    CURVES.forEach((id) => Plotly.relayout(page(id), { shapes: shape(now) }));
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
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      drawCell();
      ['map', ...SMALL].forEach((id) => Plotly.relayout(page(id), { shapes: frame() }));
    });
  }

  function pointed(event) {
    const point = event.points.find((each) => each.data.type === 'heatmap');
    if (point) look(point.pointNumber[0] * width + point.pointNumber[1]);
  }

  function named() {
    const { corner, along, across, resolution } = mission.grid;
    const [x, y] = ['x', 'y'].map((id, place) => Number(page(id).value) - corner[place]);
    const [column, row] = [along, across].map((axis) => Math.floor((x * axis[0] + y * axis[1]) / resolution ** 2));
    if (column >= 0 && column < width && row >= 0 && row < height) look(row * width + column, true);
    else page('cell').textContent = `(${page('x').value}, ${page('y').value}) is not in the field.`;
  }

  // Longitude and latitude, as in RFC 7946; without a datum, metres in the frame of the map, which the file states.
  // Rows with corners become polygons.
  function geojson(id) {
    const [head, ...rows] = [...page(id).rows];
    const names = [...head.cells].map((each) => each.textContent);
    const texts = [...head.cells].map((each) => each.classList.contains('text'));
    const isOnEarth = names.includes('longitude (°)');
    const axes = (isOnEarth ? ['longitude (°)', 'latitude (°)'] : ['x (m)', 'y (m)']).map((name) => names.indexOf(name));
    const features = rows.map((row) => {
      const values = [...row.cells].map((each, place) => (texts[place] ? each.dataset.value : Number(each.dataset.value)));
      const properties = Object.fromEntries(names.map((name, place) => [name, values[place]]));
      const { corners } = row.dataset;
      const geometry = corners ? { type: 'Polygon', coordinates: [JSON.parse(corners)] }
        : { type: 'Point', coordinates: axes.map((axis) => values[axis]) };
      return { type: 'Feature', geometry, properties };
    });
    return collection(features, isOnEarth);
  }

  function collection(features, isOnEarth) {
    const frame = isOnEarth ? {} : { frame: 'map', unit: 'm' };
    return JSON.stringify({ type: 'FeatureCollection', name: mission.name, ...frame, features }, null, 1);
  }

  // The safest way has the least sum of -log P(no hazard), by Dijkstra's algorithm.
  function steps(each) {
    const { connectivity, cutsCorners } = mission.grid;
    const [row, column] = [Math.floor(each / width), each % width];
    const isOpen = (up, right) => row + up >= 0 && row + up < height && column + right >= 0 && column + right < width
      && !blocked.has((row + up) * width + column + right);
    const found = [];
    for (const up of [-1, 0, 1]) {
      for (const right of [-1, 0, 1]) {
        const isDiagonal = up !== 0 && right !== 0;
        const isPassable = !isDiagonal || (connectivity === 8 && (cutsCorners || (isOpen(up, 0) && isOpen(0, right))));
        if ((up || right) && isPassable && isOpen(up, right)) found.push((row + up) * width + column + right);
      }
    }
    return found;
  }

  function safest(from, to) {
    const risk = (each) => -Math.log1p(-Math.min(mission.exact.hazard[each], 1 - 1e-12)) + 1e-9;
    const total = new Map([[from, risk(from)]]);
    const before = new Map();
    const open = new Set([from]);
    while (open.size) {
      const nearest = [...open].reduce((one, other) => (total.get(other) < total.get(one) ? other : one));
      if (nearest === to) break;
      open.delete(nearest);
      for (const next of steps(nearest)) {
        const sum = total.get(nearest) + risk(next);
        if (sum < (total.get(next) ?? Infinity)) {
          total.set(next, sum);
          before.set(next, nearest);
          open.add(next);
        }
      }
    }
    if (!total.has(to)) return [];
    const found = [to];
    while (found[0] !== from) found.unshift(before.get(found[0]));
    return found;
  }

  function findWay() {
    const [from, to] = ends;
    const isBlocked = blocked.has(from) || blocked.has(to);
    way = to !== null && !isBlocked ? safest(from, to) : [];
    const take = document.querySelector('[data-take="way.geojson"]');
    take.disabled = !way.length;
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
      const why = to === null ? '' : isBlocked ? ': an obstacle is in one of the two cells' : ': obstacles are between the two cells';
      page('way').textContent = `No way ${between}${why}.`;
    }
  }

  function wayEnds(place) {
    ends[place] = cell;
    findWay();
    drawMap();
  }

  function wayGeojson() {
    const places = way.map((each) => (mission.earth ? mission.earth[each] : position(each)));
    const feature = { type: 'Feature', geometry: { type: 'LineString', coordinates: places }, properties: { steps: way.length - 1 } };
    return collection([feature], Boolean(mission.earth));
  }

  const TAKES = {
    'findings.csv': () => keep(`${mission.name}_findings.csv`, 'text/csv', csv(page('findings'))),
    'findings.geojson': () => keep(`${mission.name}_findings.geojson`, 'application/geo+json', geojson('findings')),
    'safe.csv': () => keep(`${mission.name}_safe.csv`, 'text/csv', csv(page('safe'))),
    'safe.geojson': () => keep(`${mission.name}_safe.geojson`, 'application/geo+json', geojson('safe')),
    'way.geojson': () => keep(`${mission.name}_way.geojson`, 'application/geo+json', wayGeojson()),
    'deployments.csv': () => keep(`${mission.name}_deployments.csv`, 'text/csv', csv(page('deployments'))),
  };

  function pressed(event) {
    const { target } = event;
    // Numbers, the slider and tables that scroll sideways use arrow keys themselves.
    const box = target.closest('input, .wide');
    if (event.altKey || event.ctrlKey || event.metaKey || (box && (box.tagName === 'INPUT' || box.scrollWidth > box.clientWidth))) return;
    const to = { ArrowLeft: now - 1, ArrowRight: now + 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    ask(to);
  }

  function paint() {
    drawCurves();
    show(now);
  }

  page('moment').max = last;
  if (!mission.grid.along[1]) {
    // The arrows of the fields x and y go from cell to cell.
    position(0).forEach((least, place) => Object.assign(page('xy'[place]), { min: metres(least), step: mission.grid.resolution }));
  }
  if (kept && page('way-to') && ends[1] !== null) findWay();
  changeTheme(paint, signal);
  ['map', ...SMALL].forEach((id) => page(id).on('plotly_click', pointed));
  CURVES.forEach((id) => page(id).on('plotly_click', (event) => {
    const place = event.points[0].x;
    ask(mission.moments.findIndex((moment) => moment.place >= place));
  }));
  page('moment').addEventListener('input', (event) => ask(Number(event.target.value)));
  page('previous').addEventListener('click', () => ask(now - 1));
  page('next').addEventListener('click', () => ask(now + 1));
  document.addEventListener('keydown', pressed, { signal });
  signal.addEventListener('abort', () => clearInterval(timer));
  fitSheet(['map'], 640, 440, signal);
  document.querySelectorAll('.take').forEach((button) => {
    button.addEventListener('click', () => TAKES[button.dataset.take]());
  });
  saveFigures(mission.name);
  page('play').addEventListener('click', play);
  ['x', 'y'].forEach((id) => page(id).addEventListener('change', named));
  document.querySelectorAll('[name=colour], [name=layer]').forEach((field) => field.addEventListener('change', drawMap));
  document.querySelectorAll('#answers a[href^="#colour-"]').forEach((link) => {
    link.addEventListener('click', () => page(link.hash.slice(1)).click());
  });
  [...LISTS, 'lost'].forEach((id) => sortable(page(id)));
  page('deployments').tBodies[0].addEventListener('click', (event) => {
    const row = event.target.closest('tr');
    if (row.dataset.moment !== '') ask(Number(row.dataset.moment));
  });
  ['findings', 'safe', 'lost'].forEach((id) => page(id).tBodies[0].addEventListener('click', (event) => {
    look(Number(event.target.closest('tr').dataset.cell));
  }));
  if (page('way-to')) {
    page('way-from').addEventListener('click', () => wayEnds(0));
    page('way-to').addEventListener('click', () => wayEnds(1));
  }
  if (kept) {
    kept.lists.forEach(({ sorted, scrolled }, place) => {
      const table = page(LISTS[place]);
      sorted.forEach((heading) => sort(table.tHead.rows[0].cells[heading].firstChild));
      table.closest('.wide').scrollTop = scrolled;
    });
    page(kept.focus)?.focus({ preventScroll: true });
  }
  document.documentElement.dataset.ready = 'true';
  return () => ({
    moment: now === last ? null : now, cell, isAsked, isNamed, ends, colour: colourId(), focus: document.activeElement.id,
    lists: LISTS.map((id) => ({ sorted: sortedBy(page(id)), scrolled: page(id).closest('.wide').scrollTop })),
    shown: layers.filter((layer) => layer.checked).map((layer) => layer.value),
  });
}

let view = null;
let drawing = new AbortController();
async function draw(kept, main) {
  drawing.abort();
  drawing = new AbortController();
  try {
    view = await start(drawing.signal, kept, main);
  } catch (error) {
    page('trouble').hidden = false;
    page('trouble').textContent = `The page cannot be shown here: ${error.message}. It needs a browser of 2023 or later.`;
    throw error;
  }
}

// Follow the log of a running mission, and draw changes in place.
function follow() {
  const events = new EventSource('events');
  let { version: shown } = document.documentElement.dataset;
  events.addEventListener('told', (event) => { page('live').textContent = event.data; });
  events.addEventListener('error', () => {
    page('live').textContent = 'The command watch has ended, so the page no longer changes.';
  });
  events.addEventListener('page', async (event) => {
    if (event.data === shown) return;
    shown = event.data;
    const next = new DOMParser().parseFromString(await (await fetch('update')).text(), 'text/html');
    if (event.data !== shown) return;
    if (!next.getElementById('mission')) {
      location.reload();
      return;
    }
    const kept = view && view();
    ['summary', 'notes', 'mission', 'frames', 'plots'].forEach((id) => page(id).replaceWith(next.getElementById(id)));
    await draw(kept, next.querySelector('main'));
  });
}

draw(null).then(() => page('live') && follow());
