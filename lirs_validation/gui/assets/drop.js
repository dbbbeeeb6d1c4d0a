function(root){
 const wait = () => new Promise(done => setTimeout(done, 100));
 const input = () => [...document.querySelectorAll('input[type=file]')]
  .find(found => found.parentElement.textContent.includes('LABEL'));
 async function take(files){
  const yaml = file => /[.]ya?ml$/i.test(file.name);
  for (const file of [...files].sort((a, b) => yaml(a) - yaml(b))) {
   while (input().parentElement.querySelector('button').disabled) await wait();
   const one = new DataTransfer();
   one.items.add(file);
   input().files = one.files;
   input().dispatchEvent(new Event('change', {bubbles: true}));
   await wait();
  }
 }
 function dropped(event){
  if (!root.isConnected) {
   ['dragover', 'drop'].forEach(kind => window.removeEventListener(kind, dropped));
   return;
  }
  if (!root.offsetParent || !event.dataTransfer.types.includes('Files')) return;
  event.preventDefault();
  if (event.type === 'drop') take(event.dataTransfer.files);
 }
 ['dragover', 'drop'].forEach(kind => window.addEventListener(kind, dropped));
}
