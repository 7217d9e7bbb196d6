"""The look of reports: colours by role, light and dark, and rules that pages of the service use too."""

from __future__ import annotations

# The names of the colours are those of the service's pages, which bring values of their own.
LIGHT = """
  --page: #ffffff; --card: #ffffff; --ink: #17212b; --muted: #5a6875; --line: #d5dce3; --grid: #e6ebf0;
  --accent: #0b6486; --accent-pale: #e2f1f7; --good: #1b7a43; --good-pale: #e2f4e9; --warn: #8a5a00;
  --warn-pale: #fdf1d8; --bad: #b3261e; --bad-pale: #fdeceb;
  --chart-data: #55606b; --chart-model: #0b6fa4; --chart-before: #c2571a; --chart-after: #1f8a4c;
  --chart-bad: #b3261e; --chart-c1: #0b6fa4; --chart-c2: #c2571a; --chart-c3: #1f8a4c;
  --chart-c4: #7a4fb5; --chart-c5: #b0307a; --chart-c6: #7d6608;
"""
_DARK = """
  --page: #10161c; --card: #18212a; --ink: #e4eaf0; --muted: #9dabb8; --line: #33404d; --grid: #26313c;
  --accent: #58bde0; --accent-pale: #15323f; --good: #6fd197; --good-pale: #163324; --warn: #f0bd5c;
  --warn-pale: #382a10; --bad: #ff9a90; --bad-pale: #431d1a;
  --chart-data: #a9b6c2; --chart-model: #58bde0; --chart-before: #f0985c; --chart-after: #6fd197;
  --chart-bad: #ff9a90; --chart-c1: #58bde0; --chart-c2: #f0985c; --chart-c3: #6fd197;
  --chart-c4: #b99cf0; --chart-c5: #f08cc4; --chart-c6: #d8c25a;
"""

# Charts, tables of numbers, cards of answers: what a report's parts need wherever they are shown.
RULES = """
.said { font-size: 1.15rem; margin: .2rem 0 .6rem; }
.cause { font-size: 1.3rem; margin: .2rem 0; }
.verdict { display: inline-block; padding: .05rem .7rem; margin-right: .3rem; border-radius: 99px;
  font-weight: 700; text-transform: uppercase; font-size: .92rem; letter-spacing: .04em; }
.verdict.good { background: var(--good-pale); color: var(--good); }
.verdict.accent { background: var(--accent-pale); color: var(--accent); }
.verdict.warn { background: var(--warn-pale); color: var(--warn); }
.verdict.bad { background: var(--bad-pale); color: var(--bad); }
.good { color: var(--good); } .warn { color: var(--warn); } .bad { color: var(--bad); }
.hint { color: var(--muted); font-size: .87rem; }
.advice { border-left: 4px solid var(--warn); background: var(--warn-pale); padding: .5rem .8rem;
  border-radius: 4px; }
.answers { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 235px), 1fr));
  gap: .8rem; margin: 1rem 0; }
.answer { display: block; color: inherit; text-decoration: none; border: 1px solid var(--line);
  border-top: 4px solid var(--accent); border-radius: 8px; padding: .6rem .85rem .5rem;
  background: var(--card); min-width: 0; }
.answer:hover { border-color: var(--accent); }
.answer h3 { margin: 0 0 .3rem; font-size: .85rem; color: var(--muted); }
.answer p { margin: 0 0 .3rem; overflow-wrap: anywhere; }
.answer b { font-size: 1.06rem; }
.facts { display: flex; flex-wrap: wrap; gap: .5rem 1.8rem; margin: .5rem 0 .9rem; }
.facts dt { color: var(--muted); font-size: .8rem; }
.facts dd { margin: 0; font-weight: 600; font-variant-numeric: tabular-nums; }
.sentences { padding-left: 1.1rem; } .sentences li { margin: 0 0 .35rem; }
.formulas { display: grid; gap: .3rem; margin: .4rem 0 .9rem; }
.formulas code { background: var(--grid); border-left: 4px solid var(--line); border-radius: 4px;
  padding: .3rem .7rem; overflow-wrap: anywhere; }
.formulas code.added { border-left-color: var(--good); background: var(--good-pale); }
code.added { color: var(--good); }
table.numbers td { text-align: right; } table.numbers th:not(:first-child) { text-align: right; }
table.numbers tr > :last-child { padding-right: 0; }
th[scope="row"] { color: var(--ink); font-weight: 500; font-size: .92rem; }
th[scope="row"] code { font-size: 1em; }
.swatch.bars { display: inline-block; background: currentColor; width: .8rem; height: .8rem;
  border: 0; margin-right: .3rem; vertical-align: -.1rem; }
.budget { width: 100%; min-width: 200px; height: 1.3rem; display: block; border-radius: 3px; }
.budget-table th:nth-child(2) { width: 60%; }
details { margin: .5rem 0; } summary { cursor: pointer; color: var(--accent); }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 440px), 1fr));
  gap: 1rem 1.6rem; margin: .8rem 0; }
.figures.small { grid-template-columns: repeat(auto-fill, minmax(min(100%, 300px), 1fr)); }
.figures.small figcaption { font-size: .87rem; }
.figure { margin: 0; min-width: 0; break-inside: avoid; }
.figure.wide { grid-column: 1 / -1; }
.figure figcaption { font-weight: 600; font-size: .95rem; margin-bottom: .15rem; }
.key { list-style: none; display: flex; flex-wrap: wrap; gap: .1rem 1rem; margin: 0; padding: 0;
  font-size: .85rem; color: var(--muted); }
.key i { display: inline-block; width: 1.1rem; height: 3px; margin-right: .4rem; vertical-align: middle;
  background: currentColor; }
.key i.points { width: .5rem; height: .5rem; border-radius: 50%; }
.key i.bars { width: .75rem; height: .75rem; }
.key i.dashed { background: repeating-linear-gradient(90deg, currentColor 0 5px, transparent 5px 8px); }
.key i.band { height: .75rem; opacity: .55; border-radius: 2px; }
.chart-svg { display: block; width: 100%; height: auto; }
.figure:not(.wide) > .chart-svg { max-width: 620px; }
.figures.small .chart-svg { max-width: 430px; }
.chart-svg text { fill: var(--muted); font-size: 12.5px; font-family: inherit; }
.chart-svg text.name { fill: var(--ink); }
.chart-svg .grid { stroke: var(--grid); stroke-width: 1; }
.chart-svg .level { stroke: var(--muted); stroke-width: 1; stroke-dasharray: 5 4; }
.chart-svg .curve { fill: none; stroke: currentColor; stroke-width: 1.6; stroke-linejoin: round; }
.chart-svg .dash { stroke-dasharray: 6 4; }
.chart-svg .error { stroke: currentColor; stroke-width: 1.2; opacity: .75; }
.chart-svg .dots { fill: none; stroke: currentColor; stroke-width: 3; stroke-linecap: round; }
.chart-svg .dots.large { stroke-width: 5; }
.chart-svg .band { fill: currentColor; opacity: .2; }
.bar { fill: currentColor; }
.r-data { color: var(--chart-data); } .r-model { color: var(--chart-model); }
.r-before { color: var(--chart-before); } .r-after { color: var(--chart-after); }
.r-bad { color: var(--chart-bad); } .r-c1 { color: var(--chart-c1); }
.r-c2 { color: var(--chart-c2); } .r-c3 { color: var(--chart-c3); } .r-c4 { color: var(--chart-c4); }
.r-c5 { color: var(--chart-c5); } .r-c6 { color: var(--chart-c6); }
table.numbers td { white-space: nowrap; }
.for-narrow { display: none; }
@media screen and (max-width: 700px) {
  .for-wide { display: none; } .for-narrow { display: block; }
  .chart-svg text { font-size: 16px; } .figures.small .chart-svg text { font-size: 13px; }
  th { white-space: normal; }
}
@media print {
  .answer, .facts, .figure, .formulas, tr, table.numbers { break-inside: avoid; }
  h2, h3, h4, summary, .hint { break-after: avoid; } p, li { orphans: 3; widows: 3; }
  .verdict, .answer, .formulas code, .budget, .bar, .key i, .swatch { print-color-adjust: exact; }
  details::details-content { content-visibility: visible; block-size: auto; }
  summary { list-style: none; color: inherit; font-weight: 600; }
  .answers { grid-template-columns: repeat(4, 1fr); }
  .figures, .figures.small { grid-template-columns: 1fr 1fr; }
  .chart-svg text { font-size: 15px; } .figures.small .chart-svg text { font-size: 13px; }
  .for-wide text { font-size: 17px; }
  th { white-space: normal; } table { font-size: .92em; }
}
"""

# What a file needs beyond that: it has no page around it.
_FRAME = """
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 1.4rem 1.5rem 3rem; background: var(--page);
  color: var(--ink); font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans",
  "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.2rem 0 .4rem; } h4 { margin: .9rem 0 .3rem; font-size: .92rem; }
p { margin: 0 0 .7rem; }
a { color: var(--accent); }
code { font-family: ui-monospace, "Cascadia Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace;
  font-size: .9em; }
.scroll { overflow-x: auto; background:
  linear-gradient(to right, var(--page) 40%, transparent) left / 2.4rem 100% no-repeat local,
  linear-gradient(to left, var(--page) 40%, transparent) right / 2.4rem 100% no-repeat local,
  linear-gradient(to right, var(--muted), transparent) left / .5rem 100% no-repeat scroll,
  linear-gradient(to left, var(--muted), transparent) right / .5rem 100% no-repeat scroll; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .38rem .7rem .38rem 0; border-bottom: 1px solid var(--grid); }
th { font-size: .82rem; color: var(--muted); font-weight: 600; }
footer { margin-top: 2.5rem; padding-top: .8rem; border-top: 1px solid var(--line); color: var(--muted);
  font-size: .85rem; }
@page { margin: 14mm; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } }
"""


def stylesheet() -> str:
    """All rules of a file that stands alone: light, or dark where the reader's system is; light on paper."""
    light, dark = (
        f":root {{{LIGHT}  color-scheme: light;}}",
        f":root {{{_DARK}  color-scheme: dark;}}",
    )
    screen = "@media screen and (prefers-color-scheme: dark)"
    return f"{light}\n{screen} {{ {dark} }}\n{_FRAME}{RULES}"
