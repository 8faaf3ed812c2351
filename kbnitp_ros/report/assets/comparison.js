
const compared = JSON.parse(page('comparison').textContent);
const plots = JSON.parse(page('plots').textContent);

changeTheme(() => Object.entries(plots).forEach(([id, plot]) => {
  const map = compared.maps[id];
  const images = map && map.entered ? hatching(compared.grid, map.entered) : [];
  if (map) colour(plot.data[0], compared.scales[map.colours], compared.assumed[map.colours]);
  Plotly.react(page(id), plot.data, { ...themed(plot.layout), images }, config);
}));
fitSheet(Object.keys(compared.maps), 225, 190);
saveFigures(compared.name);
sortable(page('findings'));
page('take').addEventListener('click', () => keep(`${compared.name}_findings.csv`, 'text/csv', csv(page('findings'))));
document.documentElement.dataset.ready = 'true';
