function(root){
 const knob = root.querySelector('.lirs-knob'), held = new Set();
 const keys = {KeyW:[1,0],ArrowUp:[1,0],KeyS:[-1,0],ArrowDown:[-1,0],
               KeyA:[0,1],ArrowLeft:[0,1],KeyD:[0,-1],ArrowRight:[0,-1]};
 const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set;
 let last = '';
 function field(){
  let row = [...document.querySelectorAll('label')].find(l => l.textContent === 'LABEL');
  while (row && !row.querySelector('input')) row = row.parentElement;
  return row && row.querySelector('input');
 }
 function steer(forward, left){
  knob.style.transform = `translate(${-3 * left}em,${-3 * forward}em)`;
  const text = forward.toFixed(2) + ' ' + left.toFixed(2), input = field();
  if (!input || text === last) return;
  last = text;
  write.call(input, text);
  input.dispatchEvent(new Event('input', {bubbles: true}));
 }
 function pressed(){
  let f = 0, l = 0;
  held.forEach(k => { f += keys[k][0]; l += keys[k][1]; });
  steer(Math.sign(f), 0.6 * Math.sign(l));
 }
 function key(event){
  if (!root.isConnected) {
   ['keydown','keyup'].forEach(kind => window.removeEventListener(kind, key, true));
   return;
  }
  if (!(event.code in keys) || !root.offsetParent) return;
  const writes = event.target.matches('textarea,input:not([type=checkbox]):not([type=range])');
  if (writes || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  event.stopPropagation();
  if (event.type === 'keydown') held.add(event.code); else held.delete(event.code);
  pressed();
 }
 ['keydown','keyup'].forEach(kind => window.addEventListener(kind, key, true));
 window.addEventListener('blur', () => { if (held.size) { held.clear(); pressed(); } });
 root.onpointerdown = event => { root.setPointerCapture(event.pointerId); root.onpointermove(event); };
 root.onpointermove = event => {
  if (!root.hasPointerCapture(event.pointerId)) return;
  const box = root.getBoundingClientRect(), reach = box.width / 3;
  let x = (event.clientX - box.left - box.width / 2) / reach;
  let y = (event.clientY - box.top - box.height / 2) / reach;
  const far = Math.max(1, Math.hypot(x, y));
  steer(-y / far, -x / far);
 };
 root.onpointerup = root.onpointercancel = () => steer(0, 0);
}
