// The style of the player's parts, inside its shadow.

export const STYLE = `
:host { display: block; position: relative; background: #000; color: #f2f2f2; min-height: 8rem; overflow: hidden;
  font: 14px/1.4 system-ui, sans-serif; contain: content; container-type: inline-size; }
:host([hidden]) { display: none; }
canvas.picture { display: block; width: 100%; height: 100%; touch-action: none; outline: none; cursor: grab; }
canvas.picture:active { cursor: grabbing; }
canvas.picture:focus-visible { box-shadow: inset 0 0 0 2px #6db3ff; }
.bar { position: absolute; inset: auto 0 0 0; display: flex; flex-wrap: wrap; gap: 4px; align-items: center;
  padding: 20px 8px 8px; background: linear-gradient(transparent, #000c 40%); transition: opacity 0.3s; }
.bar.idle { opacity: 0; pointer-events: none; }
:host(:not([controls])) .bar, :host(:not([controls])) .network { display: none; }
button, select { min-width: 36px; min-height: 36px; border: 1px solid #fff4; border-radius: 6px; background: #222d;
  color: inherit; font: inherit; cursor: pointer; padding: 0 8px; }
button:hover, select:hover { background: #444d; }
button[aria-pressed=true] { background: #1d5fa8; border-color: #6db3ff; }
:is(button, select, input, summary):focus-visible { outline: 2px solid #6db3ff; outline-offset: 1px; }
input.time { flex: 1 1 120px; min-width: 80px; min-height: 36px; accent-color: #6db3ff; }
.clock { font-variant-numeric: tabular-nums; min-width: 5.5em; text-align: center; }
input[type=color] { width: 36px; height: 36px; padding: 2px; background: #222d; border: 1px solid #fff4;
  border-radius: 6px; }
.message { position: absolute; inset: 50% 0 auto 0; transform: translateY(-50%); text-align: center; padding: 0 1.5rem;
  pointer-events: none; text-shadow: 0 0 4px #000; }
.message:empty { display: none; }
.notes { position: absolute; top: 8px; left: 8px; max-width: min(26em, calc(100% - 16px)); display: flex; gap: 4px;
  flex-direction: column; align-items: flex-start; font-size: 12px; pointer-events: none; }
.notes > * { margin: 0; padding: 2px 8px; border-radius: 6px; background: #111c; }
.notes > :empty { display: none; }
.notes .legend { margin: 0; }
.network { position: absolute; top: 8px; right: 8px; width: min(296px, calc(100% - 16px)); background: #111d;
  border-radius: 8px; padding: 8px; max-height: calc(100% - 16px - var(--bar, 64px)); overflow: auto;
  box-sizing: border-box; }
.network[hidden] { display: none; }
.network label { display: grid; grid-template-columns: 5em 1fr 5.2em; gap: 6px; align-items: center; }
.network label[hidden] { display: none; }
.network label.of-server { grid-template-columns: 5em 1fr; }
.network .where { margin: 2px 0; }
.network .where:empty { display: none; }
.network output { text-align: right; white-space: pre-line; font-variant-numeric: tabular-nums; }
.network input[type=range] { min-height: 28px; width: 100%; accent-color: #6db3ff; }
.network canvas:is(.bits, .quality) { height: 36px; }
.network canvas { display: block; width: 100%; height: 72px; margin-top: 6px; background: #000; border-radius: 4px; }
.legend { display: flex; flex-wrap: wrap; gap: 2px 10px; margin: 6px 0 0; padding: 0; list-style: none; font-size: 12px; }
.legend i { display: inline-block; width: 10px; height: 10px; border-radius: 2px; margin-right: 4px; }
.numbers { margin: 6px 0 0; font-size: 12px; font-variant-numeric: tabular-nums; }
dialog { border: 0; border-radius: 10px; background: #181818; color: #f2f2f2; max-width: min(30rem, 90%); }
dialog::backdrop { background: #0008; }
dialog dl { display: grid; grid-template-columns: max-content 1fr; gap: 4px 16px; margin: 0 0 1em; }
dialog dd { margin: 0; }
kbd { background: #333; border-radius: 4px; padding: 0 5px; font: inherit; }
@media (prefers-reduced-motion: reduce) { .bar { transition: none; } }
@media (prefers-contrast: more) { button, select, .network { background: #000; border-color: #fff; } }
@media (max-width: 480px) { .wide { display: none; } }
@container (max-width: 480px) {
  .network { inset: auto 8px var(--bar, 104px) 8px; width: auto;
    max-height: max(50% - var(--bar, 104px), min(12rem, 100% - 16px - var(--bar, 104px))); }
  dialog dl { grid-template-columns: 1fr; gap: 0; }
  dialog dd { margin-bottom: 8px; }
}
@container (max-width: 360px) {
  .bar :is(.clock, .speed, .quality, .background, .paint, .adapt, .net, .help) { display: none; }
  .bar input.time { flex-basis: 60px; min-width: 48px; }
}
`;
