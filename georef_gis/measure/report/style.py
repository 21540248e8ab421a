"""The style of the report page: system fonts, one column, plain on paper."""

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: #1b1b1b; line-height: 1.5;
  font-family: system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 1rem 1.25rem 4rem; }
h1 { font-size: 1.8rem; line-height: 1.2; margin: 1rem 0; }
h2 { font-size: 1.35rem; margin: 2.2rem 0 .6rem; border-bottom: 2px solid #0b4f7d;
  padding-bottom: .2rem; }
h3 { font-size: 1.05rem; margin: 1.2rem 0 .4rem; }
a { color: #0b4f7d; }
a:focus-visible, [tabindex]:focus-visible { outline: 3px solid #d55e00; outline-offset: 2px; }
.skip { position: absolute; left: -999rem; }
.skip:focus { left: 1rem; top: 1rem; background: #fff; padding: .4rem .8rem; z-index: 2; }
.facts { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1.2rem; margin: 0; }
.facts dt { font-weight: 600; }
.facts dd { margin: 0; overflow-wrap: anywhere; }
nav ol { columns: 2; padding-left: 1.4rem; }
.findings { list-style: none; padding: 0; }
.findings li { border-left: .35rem solid #888; padding: .15rem .7rem; margin: .4rem 0; }
.findings li.look { border-color: #b26a00; }
.findings li.bad { border-color: #b3261e; }
figure { margin: 1.2rem 0 2rem; }
figure img { width: 100%; height: auto; display: block; border: 1px solid #ddd; }
figure.narrow img { max-width: 38rem; }
figcaption, .caption { font-size: .95rem; margin: .5rem 0 0; max-width: 50rem; }
.sign { font-weight: 700; white-space: nowrap; }
.fine .sign { color: #00664b; }
.look .sign { color: #8a4b00; }
.bad .sign { color: #b3261e; }
.told .sign { color: #444; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .22rem .5rem; border-bottom: 1px solid #ddd; vertical-align: top; }
thead th { border-bottom: 2px solid #777; background: #f3f5f7; vertical-align: bottom; }
tbody th { font-weight: 400; }
.number { text-align: right; white-space: nowrap; }
thead .number { white-space: normal; }
.word { text-align: left; }
.hidden { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
pre { white-space: pre-wrap; background: #f7f7f7; padding: .8rem; font-size: .85rem; }
ul { padding-left: 1.3rem; }
.thumbs { list-style: none; padding: 0; display: grid; gap: .7rem;
  grid-template-columns: repeat(auto-fill, minmax(8.5rem, 1fr)); }
.thumbs img { width: 100%; height: auto; display: block; border: 1px solid #ddd; }
.thumbs span { font-size: .8rem; line-height: 1.25; overflow-wrap: anywhere; display: block; }
td.word, tbody th { overflow-wrap: break-word; max-width: 46rem; }
tbody th { max-width: 16rem; }
@media (max-width: 40rem) { nav ol { columns: 1; } .facts { grid-template-columns: 1fr; }
  .facts dd { margin-bottom: .4rem; } }
@media print {
  @page { margin: 15mm; }
  body { font-size: 10pt; }
  main { max-width: none; padding: 0; }
  a { color: inherit; text-decoration: none; }
  .skip { display: none; }
  figure { break-inside: avoid; }
  figure img { max-height: 150mm; width: auto; max-width: 100%; }
  figure.narrow img { max-height: 100mm; }
  h2, h3 { break-after: avoid; }
  tr { break-inside: avoid; }
  thead { display: table-header-group; }
  .wide { overflow: visible; }
  table { font-size: 7.5pt; }
  th, td { padding: .1rem .3rem; }
  .thumbs { grid-template-columns: repeat(6, 1fr); }
  .thumbs li { break-inside: avoid; }
}
"""
