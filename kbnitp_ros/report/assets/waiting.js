const events = new EventSource('events');
const { version } = document.documentElement.dataset;
events.addEventListener('told', (event) => { page('live').textContent = event.data; });
events.addEventListener('page', (event) => {
  if (event.data !== version) location.reload();
});
