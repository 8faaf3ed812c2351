// What Python packed: see frames.py.
async function unpacked(id) {
  const text = document.getElementById(id).textContent.trim();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const NAMES = ['hazard', 'target', 'kappa'];

// Draw the page; return what is looked at. `signal` ends what listens beside the parts that are replaced.
async function start(signal, kept) {
  const mission = JSON.parse(new TextDecoder().decode(await unpacked('mission')));
  const frames = await unpacked('frames');
  const plots = JSON.parse(page('plots').textContent);
  const STILL = ['losses', 'used-up', ...NAMES.map((name) => `true-${name}`)].filter((id) => plots[id]);
  const ALL = [...NAMES, ...STILL];
  const CURVES = Object.keys(plots).filter((id) => id.startsWith('curve-'));
  const { width, height } = mission.grid;
  const cells = width * height;
  const size = NAMES.length * cells;
  for (let place = size; place < frames.length; place += 1) frames[place] += frames[place - size];
  const blocked = new Set(mission.grid.blocked);
  const last = mission.moments.length - 1;
  let now = last;
  let timer = null;
  let cell = mission.cell;
  // The page opens with what is known in the end; a path is drawn once a moment was asked for.
  let isAsked = false;
  let isNamed = false;
  if (kept) {
    ({ cell, isAsked, isNamed } = kept);
    now = kept.moment === null ? last : Math.min(kept.moment, last);
  }

  const level = (moment, name, each) => frames[moment * size + NAMES.indexOf(name) * cells + each];
  const value = (moment, name, each) => (moment === last && mission.exact
    ? mission.exact[name][each] : level(moment, name, each) / 255);
  // Where a cell is drawn, and where it lies in the frame of the map: rows of a turned field are drawn to the right.
  const center = (each) => [
    mission.grid.x + (each % width + 0.5) * mission.grid.resolution,
    mission.grid.y + (Math.floor(each / width) + 0.5) * mission.grid.resolution,
  ];

  function position(each) {
    const { corner, along, across } = mission.grid;
    return corner.map((begin, place) => begin + (each % width + 0.5) * along[place]
      + (Math.floor(each / width) + 0.5) * across[place]);
  }

  function map(moment, name) {
    const rows = [];
    for (let row = 0; row < height; row += 1) {
      const values = [];
      for (let column = 0; column < width; column += 1) {
        const each = row * width + column;
        values.push(blocked.has(each) ? null : value(moment, name, each));
      }
      rows.push(values);
    }
    return rows;
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

  // The image of the map lies under cells that let it through.
  const isSiteShown = () => Boolean(mission.site) && page('site').checked;
  const site = () => (isSiteShown() ? [{
    source: mission.site.source, xref: 'x', yref: 'y', sizing: 'stretch', layer: 'below',
    x: mission.grid.x, y: mission.grid.y + mission.site.height,
    sizex: mission.site.width, sizey: mission.site.height,
  }] : []);
  function overlaid({ data }) {
    data.filter((trace) => trace.type === 'heatmap').forEach((trace) => {
      trace.opacity = isSiteShown() ? 0.6 : 1;
    });
  }

  function overlays(moment) {
    const { deployment, survived, known, out } = mission.moments[moment];
    if (!isAsked) return {};
    const traces = { out: line(out.map((each) => mission.deployments[each].path)) };
    const path = deployment === null ? [] : mission.moments[moment].walk || mission.deployments[deployment].path;
    const look = mission.walks[survived ? 'returned' : 'lost'];
    traces.casing = line(path.length ? [path] : []);
    traces.walk = { ...line(path.length ? [path] : []), line: { width: 3, color: look.color, dash: look.dash } };
    const heard = mission.moments[moment].heard;
    traces.heard = line(heard ? [path.slice(heard[0], heard[1] + 1)] : []);
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

  function coloured(id) {
    colour(plots[id], mission.scales[id], mission.assumed[id.replace('true-', '')]);
  }

  const shape = (moment) => [{
    type: 'line', xref: 'x', yref: 'paper', x0: mission.moments[moment].place, x1: mission.moments[moment].place,
    y0: 0, y1: 1, line: { color: colours().text, width: 1 },
  }];

  // A frame round the cell that is told of: black within white, for light maps and dark ones.
  function frame() {
    const [x, y] = center(cell);
    const half = mission.grid.resolution / 2;
    if (!isAsked && !isNamed) return [];
    return [['#ffffff', 5], ['#000000', 2]].map(([color, wide]) => ({
      type: 'rect', xref: 'x', yref: 'y', x0: x - half, x1: x + half, y0: y - half, y1: y + half,
      line: { color, width: wide },
    }));
  }

  function drawMaps() {
    const images = [
      ...site(), ...hatching(mission.grid, mission.visited.map((first) => first >= 0 && first <= now)),
    ];
    const traces = overlays(now);
    NAMES.forEach((name) => {
      const { data, layout } = plots[name];
      data[0].z = map(now, name);
      coloured(name);
      overlaid(plots[name]);
      mission.traces.forEach((trace, place) => Object.assign(data[place], traces[trace]));
      // The way that was found is drawn over the path of the moment.
      if (way.length) Object.assign(data[mission.traces.indexOf('casing')], line([way]));
      // Which cells are free is told of the last moment alone.
      data.filter((trace) => trace.name === 'free').forEach((trace) => { trace.visible = now === last; });
      Plotly.react(page(name), data, { ...themed(layout), images, shapes: frame() }, config);
    });
  }

  function drawCell() {
    const places = mission.moments.map((moment) => moment.place);
    NAMES.forEach((name, place) => {
      plots.cell.data[place].x = places;
      plots.cell.data[place].y = places.map((_, moment) => value(moment, name, cell));
    });
    Plotly.react(page('cell-plot'), plots.cell.data, { ...themed(plots.cell.layout), shapes: shape(now) }, config);
    page('column').value = cell % width;
    page('row').value = Math.floor(cell / width);
    // Kappa is that of a hazard, which may not be there.
    const said = NAMES.filter((name) => name !== 'kappa' || value(now, 'hazard', cell) > 0.05);
    const values = said.map((name) => `${name} ${value(now, name, cell).toFixed(3)}`).join(', ');
    const truth = mission.truth ? ` In truth: ${mission.truth.hazard[cell] ? 'a hazard' : 'no hazard'}, `
      + `${mission.truth.target[cell] ? 'a target' : 'no target'}.` : '';
    const first = mission.visited[cell];
    const visited = first >= 0 && first <= now ? '' : ' No robot was sent here so far.';
    const [x, y] = position(cell).map((each) => Number(each.toPrecision(6)));
    const told = blocked.has(cell) ? 'blocked, no robot can enter.' : `${values}.${truth}${visited}`;
    page('cell').textContent = `At x ${x} m, y ${y} m: ${told}`;
  }

  function drawCurves() {
    CURVES.forEach((id) => {
      Plotly.react(page(id), plots[id].data, { ...themed(plots[id].layout), shapes: shape(now) }, config);
    });
  }

  function tell() {
    const moment = mission.moments[now];
    page('told').textContent = isAsked ? moment.told : 'After the last report. The slider, the arrow keys and Play show how it came about.';
    page('moment').value = now;
    page('moment').setAttribute('aria-valuetext', page('told').textContent);
    const list = page('deployment');
    list.replaceChildren();
    for (const [term, value] of moment.facts) {
      list.append(Object.assign(document.createElement('dt'), { textContent: term }));
      list.append(Object.assign(document.createElement('dd'), { textContent: value }));
    }
    document.querySelectorAll('#deployments tr[aria-current]').forEach((row) => row.removeAttribute('aria-current'));
    const row = moment.deployment === null ? null : page(`deployment-${moment.deployment}`);
    if (row) {
      row.setAttribute('aria-current', 'true');
      // Within the box of the table alone: the page stays where it is.
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
    drawMaps();
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
    // A screen reader would fall behind.
    page('told').removeAttribute('role');
    timer = setInterval(() => (now === last ? stop() : ask(now + 1)), Math.max(80, Math.min(700, 40000 / (last + 1))));
  }

  let isDue = false;
  function look(each) {
    cell = each;
    isNamed = true;
    if (isDue) return;
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      drawCell();
      ALL.forEach((id) => Plotly.relayout(page(id), { shapes: frame() }));
    });
  }

  function pointed(event) {
    const point = event.points.find((each) => each.data.type === 'heatmap');
    if (point) look(point.pointNumber[0] * width + point.pointNumber[1]);
  }

  function named() {
    const column = Math.max(0, Math.min(width - 1, Number(page('column').value)));
    const row = Math.max(0, Math.min(height - 1, Number(page('row').value)));
    look(row * width + column);
  }

  // Longitude and latitude as RFC 7946 has it; of a field without a datum metres in the frame of the map, as its readers
  // have to be told. Rows with corners are polygons.
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

  // The safest way between two cells: that with the least sum of -log P(no hazard), by Dijkstra's algorithm.
  let way = [];
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
    const [column, row, toColumn, toRow] = ['from-column', 'from-row', 'to-column', 'to-row'].map((id) => Number(page(id).value));
    const isInside = [[column, row], [toColumn, toRow]].every(([x, y]) => x >= 0 && x < width && y >= 0 && y < height);
    const [from, to] = [row * width + column, toRow * width + toColumn];
    const isBlocked = isInside && (blocked.has(from) || blocked.has(to));
    way = isInside && !isBlocked ? safest(from, to) : [];
    const take = document.querySelector('[data-take="way.geojson"]');
    take.disabled = !way.length;
    if (way.length) {
      const hazard = way.map((each) => mission.exact.hazard[each]);
      const free = hazard.reduce((product, each) => product * (1 - each), 1);
      const [safe, deadly] = mission.survival;
      const survived = hazard.slice(1).reduce((product, each) => product * (safe * (1 - each) + deadly * each), 1);
      const percent = (each) => `${(100 * each).toFixed(1)} %`;
      page('way').textContent = `The safest way has ${way.length - 1} steps. It is free of hazards with ${percent(free)}; `
        + `a robot survives it with ${percent(survived)}. ${hazard.reduce((sum, each) => sum + each, 0).toFixed(2)} hazards are expected on it.`;
    } else if (!isInside) {
      page('way').textContent = `The field has columns 0 to ${width - 1} and rows 0 to ${height - 1}: name cells of it.`;
    } else {
      page('way').textContent = isBlocked ? 'An obstacle is in one of the two cells: name others.' : 'Obstacles are between the two cells: no way leads there.';
    }
    drawMaps();
  }

  function wayGeojson() {
    const places = way.map((each) => position(each));
    const feature = { type: 'Feature', geometry: { type: 'LineString', coordinates: places }, properties: { steps: way.length - 1 } };
    return collection([feature], false);
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
    // What has keys of its own keeps them: numbers, the slider, tables that scroll sideways.
    const box = target.closest('input, .wide, #maps');
    if (event.altKey || event.ctrlKey || event.metaKey || (box && (box.tagName === 'INPUT' || box.scrollWidth > box.clientWidth))) return;
    const to = { ArrowLeft: now - 1, ArrowRight: now + 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    ask(to);
  }

  function paint() {
    STILL.forEach((id) => {
      coloured(id);
      overlaid(plots[id]);
      Plotly.react(page(id), plots[id].data, { ...themed(plots[id].layout), images: site(), shapes: frame() }, config);
    });
    drawCurves();
    show(now);
  }

  page('moment').max = last;
  page('column').max = width - 1;
  page('row').max = height - 1;
  changeTheme(paint, signal);
  ALL.forEach((id) => page(id).on('plotly_hover', pointed).on('plotly_click', pointed));
  CURVES.forEach((id) => page(id).on('plotly_click', (event) => {
    const place = event.points[0].x;
    ask(mission.moments.findIndex((moment) => moment.place >= place));
  }));
  page('moment').addEventListener('input', (event) => ask(Number(event.target.value)));
  page('previous').addEventListener('click', () => ask(now - 1));
  page('next').addEventListener('click', () => ask(now + 1));
  document.addEventListener('keydown', pressed, { signal });
  signal.addEventListener('abort', () => clearInterval(timer));
  document.querySelectorAll('.take').forEach((button) => {
    button.addEventListener('click', () => TAKES[button.dataset.take]());
  });
  saveFigures(mission.name);
  page('play').addEventListener('click', play);
  page('column').addEventListener('change', named);
  page('row').addEventListener('change', named);
  if (mission.site) page('site').addEventListener('change', paint);
  ['deployments', 'findings', 'safe'].forEach((id) => sortable(page(id)));
  page('deployments').tBodies[0].addEventListener('click', (event) => {
    const row = event.target.closest('tr');
    if (row.dataset.moment !== '') ask(Number(row.dataset.moment));
  });
  ['findings', 'safe'].forEach((id) => page(id).tBodies[0].addEventListener('click', (event) => {
    look(Number(event.target.closest('tr').dataset.cell));
  }));
  if (page('find')) {
    const [base] = mission.grid.bases;
    page('from-column').value = base % width;
    page('from-row').value = Math.floor(base / width);
    page('to-column').value = width - 1;
    page('to-row').value = height - 1;
    page('find').addEventListener('click', findWay);
  }
  document.documentElement.dataset.ready = 'true';
  return () => ({ moment: now === last ? null : now, cell, isAsked, isNamed });
}

let view = null;
let drawing = new AbortController();
async function draw(kept) {
  drawing.abort();
  drawing = new AbortController();
  try {
    view = await start(drawing.signal, kept);
  } catch (error) {
    page('trouble').hidden = false;
    page('trouble').textContent = `The page cannot be shown here: ${error.message}. It needs a browser of 2023 or later.`;
    throw error;
  }
}

// Follow the log of a mission that runs: what has changed is drawn in place.
function follow() {
  const events = new EventSource('events');
  let { version: shown } = document.documentElement.dataset;
  events.addEventListener('told', (event) => { page('live').textContent = event.data; });
  events.addEventListener('error', () => {
    page('live').textContent = 'The command watch has ended; the page is as it was then.';
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
    document.querySelector('main').replaceWith(next.querySelector('main'));
    await draw(kept);
  });
}

draw(null).then(() => page('live') && follow());
