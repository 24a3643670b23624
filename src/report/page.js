document.documentElement.classList.add('js');
const make = (tag, text, to) => { const e = document.createElement(tag); e.textContent = text; to.append(e); return e; };
const tip = make('div', '', document.body); tip.className = 'tip'; tip.hidden = true;
for (const svg of document.querySelectorAll('svg.plot[data-x]')) {
  const [x0, x1, left, right] = svg.dataset.x.split(' ').map(Number), rule = svg.querySelector('.rule');
  for (const t of svg.querySelectorAll('g.series > title')) t.remove();
  const panels = [...svg.querySelectorAll('.panel')].map(p => ({ label: p.dataset.label,
    series: [...p.querySelectorAll('.series')].map(s => ({ ...s.dataset, colour: getComputedStyle(s).getPropertyValue('--c'),
      at: s.dataset.p.split(' ').filter(v => v).map(v => v.split(',')) })) }));
  const hide = () => { tip.hidden = true; rule.style.visibility = 'hidden'; };
  svg.addEventListener('pointerleave', hide);
  svg.addEventListener('pointermove', e => {
    const m = svg.getScreenCTM(), px = (e.clientX - m.e) / m.a;
    if (px < left || px > right) return hide();
    const time = x0 + (px - left) / (right - left) * (x1 - x0), slack = (x1 - x0) / 100;
    tip.textContent = ''; make('b', time.toFixed(2) + ' s', tip);
    const table = make('table', '', tip);
    for (const p of panels) {
      if (panels.length > 1) { const r = make('tr', '', table); r.className = 'head'; make('td', p.label, r).colSpan = 2; }
      for (const s of p.series) {
        let i = -1;
        while (i + 1 < s.at.length && +s.at[i + 1][0] <= time) i++;
        if (!s.step && i + 1 < s.at.length && (i < 0 || s.at[i + 1][0] - time < time - s.at[i][0])) i++;
        const v = s.at[i], near = v && (s.step && i + 1 < s.at.length || Math.abs(v[0] - time) < Math.max(slack, .12));
        const r = make('tr', '', table), n = make('td', s.n, r), dot = document.createElement('i');
        dot.className = 'swatch'; dot.style.background = s.colour; n.prepend(dot);
        make('td', near ? v[1] + ' ' + s.u : '—', r);
      }
    }
    rule.style.visibility = 'visible'; rule.setAttribute('transform', 'translate(' + px + ' 0)'); tip.hidden = false;
    const w = tip.offsetWidth, room = document.documentElement.clientWidth;
    tip.style.left = (e.clientX + 18 + w > room ? e.clientX - w - 18 : e.clientX + 18) + scrollX + 'px';
    tip.style.top = e.clientY + 14 + scrollY + 'px';
  });
  for (const entry of svg.querySelectorAll('.entry')) {
    const mark = on => { svg.classList.toggle('focus', on);
      for (const s of svg.querySelectorAll('.series')) s.classList.toggle('on', on && s.dataset.n === entry.dataset.n); };
    entry.addEventListener('pointerenter', () => mark(true)); entry.addEventListener('pointerleave', () => mark(false));
  }
}
const box = make('dialog', '', document.body), big = make('img', '', box), says = make('p', '', box);
let row = [], at = 0;
const show = i => { at = (i + row.length) % row.length; big.src = row[at].src; says.textContent = row[at].alt; };
for (const strip of document.querySelectorAll('.strip')) for (const kind of ['frame', 'map']) {
  const all = [...strip.querySelectorAll('img.' + kind)];
  all.forEach((img, i) => img.addEventListener('click', () => { row = all; show(i); box.showModal(); }));
}
box.addEventListener('click', () => box.close());
box.addEventListener('keydown', e => { const d = { ArrowLeft: -1, ArrowRight: 1 }[e.key]; if (d) { show(at + d); e.preventDefault(); } });
