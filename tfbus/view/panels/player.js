// The bar below the scene that plays a recording. It is no part of viser's panel, since it is as
// wide as the scene. This makes it when the first state comes, moves it with the scene, and lets its
// cursor run between two states. Texts come as JSON and are set as text, never as HTML.

// viser mounts its panel again when the theme changes: the bar stays.
window.tfbusTimeline || (() => {
// The shapes of the buttons, in a box of 24 by 24.
const icons = {
  start: 'M6 5h2.5v14H6zM20 5v14L9.5 12z',
  back: 'M15.5 5v14L6 12zM17 5h2.5v14H17z',
  play: 'M7.5 4.5v15L20 12z',
  pause: 'M6.5 5h4v14h-4zM13.5 5h4v14h-4z',
  step: 'M8.5 5v14L18 12zM4.5 5H7v14H4.5z',
  loop: 'M7 7h10v3l4-4-4-4v3H5v6h2zM17 17H7v-3l-4 4 4 4v-3h12v-6h-2z',
};

const signs = {gone: '✖', back: '●', restart: '↻', conflict: '▲', gap: '◐', paused: '‖',
  dropped: '!'};
const svgNs = 'http://www.w3.org/2000/svg';
let line = null, cursor = null, parts = null, cursorAt = 0, held = null, quietUntil = 0, sentAt = 0;
// The pointer over the track, in pixels of the window; null elsewhere.
let pointerX = null;

const element = (tag, className, text) => {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
};
const shape = (tag, className, attributes) => {
  const made = document.createElementNS(svgNs, tag);
  made.setAttribute('class', className);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};
const icon = (button, name) => {
  if (button.dataset.icon === name) return;
  button.dataset.icon = name;
  const svg = shape('svg', '', {viewBox: '0 0 24 24', 'aria-hidden': 'true'});
  svg.append(shape('path', '', {d: icons[name]}));
  button.replaceChildren(svg);
};
const two = (number) => String(number).padStart(2, '0');
const passed = (s, digits) => {
  const tenths = 10 ** digits, whole = Math.floor(Math.abs(s) * tenths + 1e-6);
  const seconds = Math.floor(whole / tenths), h = Math.floor(seconds / 3600);
  const m = Math.floor(seconds / 60) % 60;
  const rest = digits ? '.' + String(whole % tenths).padStart(digits, '0') : '';
  return (s < 0 ? '-' : '') + (h ? h + ':' + two(m) : m) + ':' + two(seconds % 60) + rest;
};
// The local time of the view's machine, which need not be the browser's.
const wall = (s, digits) => {
  if (line.start_ms === null) return '';
  const date = new Date(line.start_ms + line.zone_ms + s * 1e3);
  const fraction = digits ? '.' + String(date.getUTCMilliseconds()).padStart(3, '0')
    .slice(0, digits) : '';
  return two(date.getUTCHours()) + ':' + two(date.getUTCMinutes()) + ':'
    + two(date.getUTCSeconds()) + fraction;
};
const day = (s) => line.start_ms === null ? ''
  : new Date(line.start_ms + line.zone_ms + s * 1e3).toISOString().slice(0, 10);

const now = () => {
  if (held !== null) return held;
  const run = cursor.plays ? cursor.speed * (performance.now() - cursorAt) / 1e3 : 0;
  return Math.min(cursor.at + run, line.span);
};
const send = (event) => { quietUntil = performance.now() + 400; tfbus(event); };
const seek = (s, plays) => {
  const at = Math.min(Math.max(s, 0), line.span);
  cursor = {...cursor, at, plays: plays === undefined ? cursor.plays : plays};
  cursorAt = performance.now();
  send({do: 'seek', s: at, ...(plays === undefined ? {} : {plays})});
  draw();
};
const toggle = () => send({do: 'play', plays: !cursor.plays});

const make = () => {
  const bar = element('div');
  bar.id = 'tfbus-player';
  bar.setAttribute('role', 'group');
  bar.setAttribute('aria-label', 'player of the recording');
  const button = (name, label, className, action) => {
    const made = element('button', className);
    made.type = 'button';
    made.title = label;
    made.setAttribute('aria-label', label);
    if (name) icon(made, name);
    made.onclick = () => { action(); made.blur(); };
    return made;
  };
  const row = element('div', 'tfp-row'), legend = element('div', 'tfp-legend');
  const list = element('div', 'tfp-list'), track = element('div', 'tfp-track');
  list.hidden = true;
  const speed = element('select');
  speed.setAttribute('aria-label', 'speed');
  speed.title = 'Speed (keys [ and ])';
  speed.onchange = () => { send({do: 'speed', speed: Number(speed.value)}); speed.blur(); };
  const play = button('play', 'Play (space)', 'tfp-play', toggle);
  const loop = button('loop', 'Begin again at the end', 'tfp-loop',
    () => send({do: 'loop', loops: !cursor.loops}));
  const times = element('div', 'tfp-times');
  times.append(...['tfp-date', '', ''].map((name, n) => element(n === 1 ? 'b' : 'span', name)));
  const room = element('div', 'tfp-room');
  const all = button('', 'List of events', 'tfp-all', () => {
    list.hidden = !list.hidden;
    all.setAttribute('aria-expanded', String(!list.hidden));
    mark(now());
  });
  row.append(
    button('start', 'To the beginning', '', () => seek(0)),
    button('back', 'One message back (key ,)', '', () => send({do: 'step', by: -1})),
    play,
    button('step', 'One message forward (key .)', '', () => send({do: 'step', by: 1})),
    loop, speed, times, room, legend, all);
  track.tabIndex = 0;
  track.setAttribute('role', 'slider');
  track.setAttribute('aria-label', 'time in the recording');
  const svg = shape('svg', '', {}), head = element('div', 'tfp-head');
  const tip = element('div', 'tfp-tip');
  tip.hidden = true;
  const axis = element('div', 'tfp-axis');
  track.append(svg, head, tip);
  bar.append(list, row, track, axis);
  document.body.append(bar);
  parts = {bar, row, play, loop, speed, times, legend, all, list, track, svg, head, tip, axis};

  let played = false;
  track.onpointerdown = (event) => {
    if (event.button) return;
    track.setPointerCapture(event.pointerId);
    played = cursor.plays;
    held = under(event.clientX);
    seek(held, false);
  };
  // Entered also where the track comes below a pointer that rests.
  track.onpointerenter = track.onpointermove = (event) => {
    pointerX = event.clientX;
    hint();
    if (held === null) return;
    held = under(pointerX);
    draw();
    if (performance.now() - sentAt < 50) return;
    sentAt = performance.now();
    seek(held, false);
  };
  track.onpointerup = track.onpointercancel = (event) => {
    if (held === null) return;
    const at = held;
    held = null;
    seek(at, played);
  };
  track.onpointerleave = () => { pointerX = null; hint(); };
  track.onkeydown = (event) => {
    const steps = {ArrowLeft: -1, ArrowRight: 1, ArrowDown: -1, ArrowUp: 1, PageDown: -10,
      PageUp: 10};
    const step = event.shiftKey ? 10 : 1;
    if (event.key in steps) seek(now() + step * steps[event.key]);
    else if (event.key === 'Home') seek(0);
    else if (event.key === 'End') seek(line.span);
    else return;
    event.preventDefault();
    event.stopPropagation();
  };
  // Keys that viser's commands do not have.
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.('input, textarea, '
      + 'select, [contenteditable]')) return;
    const steps = {',': -1, '.': 1}, speeds = {'[': -1, ']': 1};
    if (event.key in steps) send({do: 'step', by: steps[event.key]});
    if (event.key in speeds) send({do: 'faster', by: speeds[event.key]});
  });
  addEventListener('resize', fit);
  setInterval(fit, 300);
};

// What is near a time: within five pixels, the nearest start first.
const near = (s) => {
  const within = 5 * line.span / Math.max(parts.track.clientWidth, 1);
  const far = ([kind, from, to]) => from <= s && s <= to ? Math.min(s - from, within)
    : Math.min(Math.abs(from - s), Math.abs(to - s));
  const found = line.marks.filter((each) => far(each) <= within);
  return found.sort((a, b) => far(a) - far(b)).slice(0, 3);
};
// The time below a place of the window.
const under = (x) => {
  const box = parts.track.getBoundingClientRect();
  return Math.min(Math.max((x - box.left) / box.width, 0), 1) * line.span;
};
// The tip at the pointer; again whenever the bar or its timeline changes below a pointer that rests.
const hint = () => {
  const {tip, track} = parts;
  tip.hidden = pointerX === null;
  if (tip.hidden) return;
  const s = under(pointerX);
  tip.replaceChildren(element('div', '', [passed(s, 1), wall(s, 1)].filter(Boolean).join(' · ')));
  for (const [kind, from, to, text] of near(s)) {
    const entry = element('div');
    entry.append(element('span', 'tfp-sign', signs[kind]), text);
    tip.append(entry);
  }
  const width = track.clientWidth, half = tip.offsetWidth / 2;
  const x = line.span ? s / line.span * width : 0;
  tip.style.left = Math.min(Math.max(x, half - 8), width - half + 8) + 'px';
};

const share = (s) => (line.span ? 100 * s / line.span : 0).toFixed(4) + '%';
const steps = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];
const scale = () => {
  const wanted = line.span / Math.max(parts.track.clientWidth / 90, 2);
  const step = [0.001, 0.01, 0.1, 0.5, ...steps].find((each) => each >= wanted) || 86400 * 7;
  if (parts.axis.dataset.of === step + ' ' + line.id) return;
  parts.axis.dataset.of = step + ' ' + line.id;
  parts.track.querySelectorAll('.tfp-tick').forEach((each) => each.remove());
  const digits = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
  for (let n = 0; n * step <= line.span * (1 + 1e-9); n += 1) {
    const tick = element('span', 'tfp-tick', passed(n * step, digits));
    tick.style.left = share(n * step);
    parts.track.append(tick);
  }
};
const paint = () => {
  const {svg, legend, speed, list, all} = parts;
  svg.replaceChildren();
  const most = Math.max(...line.activity, 1);
  if (line.activity.length) {
    const width = 100 / line.activity.length;
    line.activity.forEach((count, n) => {
      const tall = count ? 2 + 13 * count / most : 0;
      svg.append(shape('rect', 'tfp-activity', {x: n * width + '%', width: width * 1.02 + '%',
        y: 18 - tall, height: tall}));
    });
  }
  svg.append(shape('rect', 'tfp-rail', {x: 0, y: 20, width: '100%', height: 10, rx: 3}));
  parts.played = shape('rect', 'tfp-played', {x: 0, y: 20, width: 0, height: 10, rx: 3});
  svg.append(parts.played);
  // A lane for each kind that takes time, so that none hides another.
  const lanes = {gap: [20, 3.4], gone: [23.3, 3.4], conflict: [26.6, 3.4], paused: [20, 10],
    dropped: [20, 10]};
  for (const [kind, from, to] of line.marks) {
    if (to > from && lanes[kind]) svg.append(shape('rect', 'tfp-band tfp-' + kind, {x: share(from),
      width: share(to - from), y: lanes[kind][0], height: lanes[kind][1]}));
  }
  for (const [kind, from] of line.marks) {
    const tick = shape('svg', 'tfp-' + kind, {x: share(from), y: 0, width: 1, height: 42});
    tick.style.width = '1px';
    if (kind === 'gap') tick.append(shape('rect', '', {x: -0.75, y: 18, width: 1.5, height: 14}));
    else tick.append(shape('rect', '', {x: -1, y: 14, width: 2, height: 20}),
      shape('path', '', {d: 'M-4.5 9h9L0 16z'}));
    svg.append(tick);
  }
  legend.replaceChildren(...line.kinds.map(([kind, label, count]) => {
    const made = element('button');
    made.type = 'button';
    made.title = 'Go to the next: ' + label;
    made.append(element('span', 'tfp-sign tfp-' + kind, signs[kind]), element('span', '', count),
      element('i', '', label));
    made.onclick = () => {
      const of = line.marks.filter((each) => each[0] === kind), at = now() + 1e-6;
      const next = of.find((each) => each[1] > at) || of[0];
      if (next) seek(next[1]);
      made.blur();
    };
    return made;
  }));
  const count = line.marks.length + line.more;
  all.hidden = !count;
  all.replaceChildren(element('span', '', '☰'));
  all.title = count + (count === 1 ? ' event' : ' events') + ': the list';
  list.replaceChildren(...line.marks.slice(0, 300).map(([kind, from, to, text], n) => {
    const made = element('button');
    made.type = 'button';
    made.dataset.n = n;
    made.append(element('span', 'tfp-sign tfp-' + kind, signs[kind]),
      element('span', 'tfp-at', [passed(from, 1), wall(from, 0)].filter(Boolean).join(' · ')),
      element('span', 'tfp-what', text));
    made.onclick = () => { seek(from); made.blur(); };
    return made;
  }));
  const left = line.more + Math.max(line.marks.length - 300, 0);
  if (left) list.append(element('div', 'tf-dim', 'and ' + left + ' more'));
  if (!count) list.hidden = true;
  speed.replaceChildren(...line.speeds.map(choice));
  parts.axis.dataset.of = '';
};
const choice = (speed) => {
  const option = element('option', '', speed + '×');
  option.value = speed;
  return option;
};
// The last event before the cursor stands out in the list.
const mark = (s) => {
  const {list} = parts;
  if (list.hidden) return;
  const last = line.marks.slice(0, 300).findLastIndex((each) => each[1] <= s + 1e-6);
  if (list.dataset.now === line.id + ' ' + last) return;
  list.dataset.now = line.id + ' ' + last;
  list.querySelector('.tfp-now')?.classList.remove('tfp-now');
  const row = list.querySelector('[data-n="' + last + '"]');
  row?.classList.add('tfp-now');
  row?.scrollIntoView({block: 'nearest'});
};
const set = (node, text) => { if (node.textContent !== text) node.textContent = text; };
const draw = () => {
  if (!line || !cursor) return;
  const {play, loop, speed, times, head, played, track} = parts, s = now();
  icon(play, cursor.plays ? 'pause' : 'play');
  play.title = cursor.plays ? 'Pause (space)' : 'Play (space)';
  play.setAttribute('aria-label', cursor.plays ? 'Pause' : 'Play');
  loop.setAttribute('aria-pressed', String(cursor.loops));
  if (speed.value !== String(cursor.speed) && document.activeElement !== speed) {
    // A program may have set another one.
    if (![...speed.options].some((each) => each.value === String(cursor.speed)))
      speed.append(choice(cursor.speed));
    speed.value = String(cursor.speed);
  }
  const [date, clock, from] = times.children;
  const digits = line.span < 10 ? 3 : 1;
  set(date, day(s) ? day(s) + ' ' : '');
  set(clock, wall(s, digits) ? wall(s, digits) + ' ' : '');
  set(from, passed(s, digits) + ' / ' + passed(line.span, digits));
  head.style.left = share(s);
  played.setAttribute('width', share(s));
  track.setAttribute('aria-valuemin', 0);
  track.setAttribute('aria-valuemax', line.span);
  track.setAttribute('aria-valuenow', s.toFixed(3));
  track.setAttribute('aria-valuetext', passed(s, 1));
  mark(s);
};
// Above the lower edge of the scene; in a narrow window the panel covers that.
const fit = () => {
  const {bar} = parts, canvas = document.querySelector('canvas[data-engine]');
  bar.hidden = !canvas || !document.querySelector('.tfbus-player-state');
  if (bar.hidden) return;
  const scene = canvas.getBoundingClientRect();
  const panel = document.querySelector('.tfbus-channel')
    ?.closest('.mantine-Paper-root')?.getBoundingClientRect();
  const covers = panel && panel.top > scene.top + 40 && panel.width > 0.8 * scene.width;
  const low = covers ? Math.min(panel.top, scene.bottom) : scene.bottom;
  const place = {left: scene.left + 8 + 'px', width: Math.max(scene.width - 16, 120) + 'px',
    bottom: Math.max(innerHeight - low, 0) + 8 + 'px'};
  let moved = false;
  for (const [name, value] of Object.entries(place)) {
    if (bar.style[name] === value) continue;
    bar.style[name] = value;
    moved = true;
  }
  bar.classList.toggle('tfp-narrow', scene.width < 760);
  scale();
  if (moved) hint();
};
const run = () => {
  if (parts && !parts.bar.hidden && cursor && cursor.plays && held === null) draw();
  requestAnimationFrame(run);
};

window.tfbusTimeline = (given) => {
  line = given;
  if (!parts) { make(); requestAnimationFrame(run); }
  paint();
  fit();
  hint();
  draw();
};
window.tfbusCursor = (given) => {
  if (held !== null) { cursor.jumps = given.jumps; return; }
  // What was sent before the server had our last wish would let the cursor jump back.
  if (cursor && performance.now() < quietUntil && given.jumps === cursor.jumps) return;
  quietUntil = 0;
  // What is on its way takes time: a cursor that runs as foreseen is not pushed back and forth.
  if (cursor && given.plays && given.jumps === cursor.jumps
    && Math.abs(given.at - now()) < 0.2 * given.speed) return;
  cursor = given;
  cursorAt = performance.now();
  draw();
};
for (const [call, given] of window.tfbusEarly || []) window[call](given);
window.tfbusEarly = [];
})();
