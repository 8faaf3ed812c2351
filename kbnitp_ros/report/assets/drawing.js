'use strict';

// What draws without knowing the mission.
const page = (id) => document.getElementById(id);

function element(name, content = [], attributes = {}) {
  const made = Object.assign(document.createElement(name), attributes);
  made.append(...[content].flat());
  return made;
}

// Unpack what page.py has packed.
async function unpacked(text, format) {
  const bytes = Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream(format)));
}

function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return { text: of('text'), paper: of('paper'), line: of('line'), obstacle: of('obstacle') };
}

function themed(layout) {
  const { text, paper, line: grid } = colours();
  const axes = Object.keys(layout).filter((name) => /^[xy]axis/.test(name));
  const changed = { ...layout, font: { color: text }, hoverlabel: { bgcolor: paper, font: { color: text } } };
  axes.forEach((name) => {
    changed[name] = { ...layout[name], gridcolor: grid, linecolor: text, tickcolor: text, zerolinecolor: grid };
  });
  return changed;
}

// Set the colours of a map; the scale of a probability shows the prior.
function colour(cells, scale, assumed) {
  cells.colorscale = scale[isDark() ? 'dark' : 'light'];
  if (assumed === undefined) return;
  const ticks = [0, 1, ...(assumed > 0.08 && assumed < 0.92 ? [assumed] : [])];
  cells.colorbar = { ...cells.colorbar, tickvals: ticks, ticktext: ticks.map((each) => Number(each.toFixed(2))) };
}

const config = { displayModeBar: false, responsive: true };

// Plotly has no hatching for maps, so unvisited cells are covered by a picture.
const canvas = document.createElement('canvas');
function hatching(grid, entered) {
  const { width, height } = grid;
  const side = Math.max(3, Math.floor(900 / Math.max(width, height)));
  const blocked = new Set(grid.blocked);
  canvas.width = width * side;
  canvas.height = height * side;
  const context = canvas.getContext('2d');
  context.beginPath();
  let unvisited = 0;
  entered.forEach((isEntered, each) => {
    if (!isEntered && !blocked.has(each)) {
      context.rect((each % width) * side, (height - 1 - Math.floor(each / width)) * side, side, side);
      unvisited += 1;
    }
  });
  context.clip();
  context.beginPath();
  const reach = canvas.width + canvas.height;
  // The picture is about 300 pixels wide in the page.
  const pixel = Math.max(canvas.width, canvas.height) / 300;
  for (let begin = 0; begin < reach; begin += 14 * pixel) {
    context.moveTo(begin, 0);
    context.lineTo(begin - canvas.height, canvas.height);
  }
  // Dark lines within light lines are visible on light and dark maps.
  for (const [style, wide] of [['rgba(255, 255, 255, 0.5)', 2.5], ['#505050', 1]]) {
    context.strokeStyle = style;
    context.lineWidth = wide * pixel;
    context.stroke();
  }
  return unvisited ? [{
    source: canvas.toDataURL(), xref: 'x', yref: 'y', sizing: 'stretch', layer: 'above',
    x: grid.x, y: grid.y + height * grid.resolution, sizex: width * grid.resolution, sizey: height * grid.resolution,
  }] : [];
}

const scatter = (mode, at, style) => ({ type: 'scatter', mode, x: [], y: [], hoverinfo: 'skip', ...at, ...style });
const curve = (x, y, name, line, style) => scatter('lines', { x, y }, { name, line, hoverinfo: 'all', hovertemplate: '%{y:.4g}', ...style });
const bare = { dragmode: false, paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)' };

// A panel of curves. Plotly reads labels as HTML and TeX.
function panel(label, data, look = {}) {
  const text = label.replaceAll('&', '&amp;').replaceAll('<', '&lt;').replaceAll('$', '&#36;');
  const layout = {
    ...bare, height: look.height || 280, hovermode: 'x unified', showlegend: true, margin: { l: 50, r: 10, t: 40, b: 40 },
    legend: { orientation: 'h', x: 0, y: 1, yanchor: 'bottom' },
    xaxis: { title: { text: 'reports taken in' }, automargin: true },
    yaxis: { title: { text, standoff: 6 }, automargin: true, ...(look.range && { range: look.range }) },
  };
  return { label, data, layout };
}

// A heatmap of the cells of a field, where it lies.
const heatmap = (grid, z, style) => ({
  type: 'heatmap', z, x0: grid.x + grid.resolution / 2, dx: grid.resolution, y0: grid.y + grid.resolution / 2, dy: grid.resolution, ...style,
});

// An arrow above the left edge of a map, at an angle in rad from the right, with a label at its head.
const ABOVE = 64;
const arrow = ([text, angle]) => ({
  xref: 'paper', yref: 'paper', x: 0, y: 1, xshift: ABOVE / 2, yshift: ABOVE / 2, text,
  ax: 20 * Math.cos(angle), ay: -20 * Math.sin(angle), arrowside: 'start', arrowhead: 2, arrowcolor: '#808080',
});

// The layout of a map: rows of a turned field are drawn to the right.
function mapLayout(grid) {
  const turned = grid.yaw ? { x: -grid.yaw, y: Math.PI / 2 - grid.yaw } : {};
  const arrows = Object.entries({ ...turned, ...(grid.north !== null && { N: grid.north - grid.yaw }) });
  const axis = (least, cells, text) => ({
    showgrid: false, zeroline: false, constrain: 'domain', ticks: 'outside', nticks: 6, automargin: true,
    range: [least, least + cells * grid.resolution], title: { text, standoff: 4 },
  });
  return {
    ...bare, showlegend: false, margin: { l: 40, r: 10, t: arrows.length ? ABOVE : 8, b: 36 }, annotations: arrows.map(arrow),
    xaxis: axis(grid.x, grid.width, grid.yaw ? 'along the rows (m)' : 'x (m)'),
    yaxis: { ...axis(grid.y, grid.height, grid.yaw ? 'across the rows (m)' : 'y (m)'), scaleanchor: 'x' },
  };
}

// A row of a table: columns are [heading, key, decimals], without decimals for texts, with null for metres.
function tableRow(columns, values, hasButton) {
  const row = element('tr', [], { values });
  if ('cell' in values) row.dataset.cell = values.cell;
  columns.forEach(([, key, decimals, isMinor], place) => {
    const value = values[key] ?? '';
    const text = value === '' || decimals === undefined ? String(value) : decimals === null ? metres(value) : value.toFixed(decimals);
    const field = element('td', place || !hasButton ? text : element('button', text, { type: 'button' }));
    field.className = kind(decimals, isMinor);
    field.dataset.value = value;
    row.append(field);
  });
  return row;
}

const metres = (number) => String(Number(number.toFixed(3)) + 0);
const kind = (decimals, isMinor) => `${decimals === undefined ? 'text' : ''} ${isMinor ? 'minor' : ''}`.trim();

// Fill a table, in the order that its headings have been given.
function fill(table, columns, rows) {
  const heads = table.tHead.rows[0];
  if (heads.textContent !== columns.map(([heading]) => heading).join('')) {
    heads.replaceChildren(...columns.map(([heading, , decimals, isMinor]) => element(
      'th', element('button', heading, { type: 'button' }), { scope: 'col', className: kind(decimals, isMinor) },
    )));
  }
  table.tBodies[0].replaceChildren(...rows);
  order(table);
}

function order(table) {
  const head = table.querySelector('[aria-sort]');
  if (!head) return;
  const place = head.cellIndex;
  const key = (row) => row.cells[place].dataset.value;
  const sign = head.getAttribute('aria-sort') === 'ascending' ? 1 : -1;
  table.tBodies[0].append(...[...table.tBodies[0].rows].sort((one, other) => {
    const [a, b] = [key(one), key(other)];
    // Unknown values come last.
    if (a === '' || b === '') return (a === '') - (b === '');
    return sign * (head.classList.contains('text') ? a.localeCompare(b) : Number(a) - Number(b));
  }));
}

function sort(head) {
  // The first click sorts in descending order.
  const next = head.getAttribute('aria-sort') === 'descending' ? 'ascending' : 'descending';
  [...head.parentNode.cells].forEach((each) => each.removeAttribute('aria-sort'));
  head.setAttribute('aria-sort', next);
  order(head.closest('table'));
}

function keep(name, type, text) {
  const link = Object.assign(document.createElement('a'), {
    href: URL.createObjectURL(new Blob([text], { type })), download: name,
  });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

// The table in its present order, in full precision.
function csv(table) {
  const quoted = (text) => (/[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const heads = [...table.tHead.rows[0].cells].map((each) => each.textContent);
  const rows = [...table.tBodies[0].rows].map((row) => [...row.cells].map((each) => each.dataset.value));
  return [heads, ...rows].map((row) => `${row.map(quoted).join(',')}\r\n`).join('');
}
