'use strict';

// Functions of both pages: of a mission, and of two missions.
const page = (id) => document.getElementById(id);

function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
}

// Let the button change between light and dark; paint now and after each change.
function changeTheme(paint, signal) {
  const painted = () => {
    page('theme').textContent = isDark() ? 'Light' : 'Dark';
    paint();
  };
  page('theme').addEventListener('click', () => {
    document.documentElement.dataset.theme = isDark() ? 'light' : 'dark';
    painted();
  });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', painted, { signal });
  painted();
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return { text: of('text'), paper: of('paper'), line: of('line') };
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

// Resize plots for print: a sheet of A4 is 700 pixels wide between its margins.
function fitSheet(ids, width, height, signal) {
  const resize = (size) => ids.forEach((id) => Plotly.relayout(page(id), size));
  window.addEventListener('beforeprint', () => resize({ width, height }), { signal });
  window.addEventListener('afterprint', () => resize({ width: null, height: null, autosize: true }), { signal });
}

function saveFigures(name) {
  document.querySelectorAll('.save').forEach((button) => {
    const { plot } = button.dataset;
    button.addEventListener('click', () => Plotly.downloadImage(page(plot), {
      format: 'png', scale: 3, filename: `${name}_${plot}`,
    }));
  });
}

function sort(heading) {
  const head = heading.closest('th');
  const place = [...head.parentNode.children].indexOf(head);
  // The first click sorts in descending order.
  const ascending = head.getAttribute('aria-sort') === 'descending';
  [...head.parentNode.children].forEach((each) => each.removeAttribute('aria-sort'));
  head.setAttribute('aria-sort', ascending ? 'ascending' : 'descending');
  const body = head.closest('table').tBodies[0];
  const key = (row) => row.children[place].dataset.value;
  const sign = ascending ? 1 : -1;
  const rows = [...body.rows].sort((one, other) => {
    const [a, b] = [key(one), key(other)];
    // Unknown values come last.
    if (a === '' || b === '') return (a === '') - (b === '');
    const order = head.classList.contains('text') ? a.localeCompare(b) : Number(a) - Number(b);
    return sign * order;
  });
  body.append(...rows);
}

// The headings to click, by index, that reproduce the order of a table.
function sortedBy(table) {
  return [...table.tHead.rows[0].cells].flatMap((head, place) => ({ descending: [place], ascending: [place, place] })[head.getAttribute('aria-sort')] || []);
}

function sortable(table) {
  table.tHead.addEventListener('click', (event) => {
    if (event.target.tagName === 'BUTTON') sort(event.target);
  });
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
