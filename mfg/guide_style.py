"""The looks of the assembly guide, on screen and on A4 paper."""

from __future__ import annotations

STYLE = """
:root { --ink: #22272b; --quiet: #5b646c; --rule: #d5dade; --tint: #f4f6f7; --accent: #c2255c; }
* { box-sizing: border-box; }
html { background: #fff; color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
body { max-width: 54rem; margin: 0 auto; padding: 2rem 1.4rem 4rem; }
h1 { font-size: 2.1rem; line-height: 1.15; margin: 0 0 .2rem; letter-spacing: -.015em; }
h2 { font-size: 1.35rem; margin: 2.6rem 0 .7rem; padding-top: .7rem; border-top: 2px solid var(--ink); }
h3 { font-size: 1.05rem; margin: 0 0 .4rem; } h3.after { margin-top: 1rem; }
p { margin: 0 0 .6rem; } ul, ol { margin: .2rem 0 .8rem; padding-left: 1.3rem; } li { margin-bottom: .25rem; }
svg { font-family: system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
.cover img { display: block; width: 100%; height: auto; }
.lead, .quiet { color: var(--quiet); }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(7.5rem, 1fr)); gap: .6rem; margin: 1rem 0; }
.facts div { background: var(--tint); padding: .6rem .8rem; border-radius: 4px; }
.facts b { display: block; font-size: 1.25rem; } .facts span { font-size: .85rem; color: var(--quiet); }
.step { border: 1px solid var(--rule); border-radius: 6px; padding: .9rem 1rem .5rem; margin: 0 0 1rem; }
.step h3 b { display: inline-block; background: var(--ink); color: #fff; border-radius: 4px; padding: 0 .5em;
             margin-right: .5em; }
.picture, .diagram { display: block; width: 100%; height: auto; }
.parts { display: grid; grid-template-columns: repeat(3, 1fr); gap: .8rem; }
.parts figure { margin: 0; border: 1px solid var(--rule); border-radius: 6px; padding: .5rem; }
figcaption { font-size: .84rem; line-height: 1.35; } figcaption b { font-size: .95rem; }
.warn { background: #fff0e6; border-left: 4px solid #e8590c; padding: .5rem .8rem; }
.safety { background: #fff5f5; border: 1.5px solid #e03131; border-radius: 6px; padding: .8rem 1rem .3rem; }
table { border-collapse: collapse; width: 100%; font-size: .86rem; line-height: 1.35; margin: .4rem 0 1rem; }
th { text-align: left; border-bottom: 1.5px solid var(--ink); } td { border-bottom: 1px solid var(--rule); }
th, td { padding: .28rem .7rem .28rem 0; vertical-align: top; overflow-wrap: break-word; }
code, pre { font: .84rem/1.45 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
pre { background: var(--tint); padding: .7rem .9rem; border-radius: 4px; white-space: pre-wrap; }
.tick::before { content: "☐ "; }
@page { size: A4; margin: 14mm 13mm 15mm; }
@media print {
  html { font-size: 10pt; } body { max-width: none; padding: 0; }
  * { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  h2 { break-before: page; break-after: avoid; margin-top: 0; border-top: 0; }
  h3 { break-after: avoid; } p, li { orphans: 3; widows: 3; }
  .step, figure, tr, .safety, .facts, .diagram { break-inside: avoid; }
  h2.flow { break-before: auto; margin-top: 1.2rem; }
  .step { padding: .5rem .8rem .2rem; margin-bottom: 4mm; } .step li { margin-bottom: .1rem; }
  .step .picture { height: 71mm; width: auto; max-width: 100%; margin: 0 auto; }
  .cover .picture { height: 100mm; }
  .cover img { width: auto; height: 104mm; margin: 0 auto; } .safety li { margin-bottom: .1rem; font-size: 9pt; }
}
"""
