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

const config = { displayModeBar: false, responsive: true };

const scatter = (mode, at, style) => ({ type: 'scatter', mode, x: [], y: [], ...at, ...style });
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
