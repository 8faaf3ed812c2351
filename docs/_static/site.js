// A button that copies, on each block of code.
document.addEventListener('DOMContentLoaded', () => {
  document.querySelectorAll('div.highlight').forEach((block) => {
    const code = block.querySelector('pre').textContent;
    const button = Object.assign(document.createElement('button'), { className: 'copy', type: 'button', textContent: 'Copy' });
    button.addEventListener('click', async () => {
      await navigator.clipboard.writeText(code);
      button.textContent = 'Copied';
      setTimeout(() => { button.textContent = 'Copy'; }, 2000);
    });
    block.append(button);
  });
  // A link to a part of what is folded opens it.
  const open = () => document.getElementById(decodeURIComponent(location.hash.slice(1)))?.closest('details')?.setAttribute('open', '');
  addEventListener('hashchange', open);
  open();
});
