function(root){
 const wait = () => new Promise(done => setTimeout(done, 100));
 const input = () => [...document.querySelectorAll('input[type=file]')]
  .find(found => found.parentElement.textContent.includes('LABEL'));
 async function take(files){
  while (input().parentElement.querySelector('button').disabled) await wait();
  const one = new DataTransfer();
  const head = 'lirs-files ' + JSON.stringify(files.map(file => [file.name, file.size])) + '\n';
  const names = files.map(file => file.name).join(', ');
  one.items.add(files.length > 1 ? new File([head, ...files], names) : files[0]);
  input().files = one.files;
  input().dispatchEvent(new Event('change', {bubbles: true}));
 }
 function dropped(event){
  if (!root.isConnected) {
   ['dragover', 'drop', 'click', 'change'].forEach(kind => window.removeEventListener(kind, dropped, true));
   return;
  }
  if (event.type === 'click' && input()) input().multiple = true;
  if (event.type === 'change' && event.target === input() && event.target.files.length > 1) {
   event.stopImmediatePropagation();
   take([...event.target.files]);
  }
  if (!root.offsetParent || !event.dataTransfer || !event.dataTransfer.types.includes('Files')) return;
  event.preventDefault();
  if (event.type === 'drop' && event.dataTransfer.files.length) take([...event.dataTransfer.files]);
 }
 ['dragover', 'drop', 'click', 'change'].forEach(kind => window.addEventListener(kind, dropped, true));
}
