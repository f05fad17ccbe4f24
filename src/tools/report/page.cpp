#include "tools/report/page.h"

#include <algorithm>

#include "semantic_topo_loop/types/text.h"
#include "tools/report/chart.h"

namespace semantic_topo_loop::core {
namespace {

constexpr const char* kStyle = R"css(
:root { --ink: #1f2933; --soft: #616e7c; --rule: #e4e7eb; --paper: #fff; --ground: #f5f7fa; --accent: #1864ab; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink);
  font: 14px/1.5 Lato, "Segoe UI", "Helvetica Neue", Roboto, "Liberation Sans", Arial, sans-serif; }
main { max-width: 1200px; margin: 0 auto; padding: 28px 16px 48px; }
h1 { margin: 0; font-size: 26px; font-weight: 700; letter-spacing: -.01em; }
h2 { margin: 0 0 2px; font-size: 17px; font-weight: 700; }
h3 { margin: 0 0 4px; font-size: 14px; font-weight: 700; }
p { margin: 0 0 10px; color: var(--soft); max-width: 140ch; }
.tiles { display: flex; flex-wrap: wrap; gap: 10px; margin: 18px 0 4px; }
.tile { flex: 1 1 150px; background: var(--paper); border: 1px solid var(--rule); border-radius: 8px; padding: 10px 14px; }
.tile b { display: block; font-size: 20px; line-height: 1.3; font-variant-numeric: tabular-nums; white-space: nowrap; }
.tile span { color: var(--soft); font-size: 12.5px; }
section { background: var(--paper); border: 1px solid var(--rule); border-radius: 8px; padding: 18px 24px 16px;
  margin-top: 14px; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 8px 36px; align-items: start; }
.pair > * { min-width: 0; }
.wide { overflow-x: auto; }
.wide > svg { min-width: 680px; }
.chart { display: block; width: 100%; height: auto; font-size: 11px; }
.grid line { stroke: #edf0f3; stroke-width: 1; shape-rendering: crispEdges; }
.ticks text { fill: var(--soft); font-variant-numeric: tabular-nums; }
.name { font-weight: 600; text-anchor: middle; paint-order: stroke; stroke: #fff; stroke-width: 3px; stroke-linejoin: round; }
.note { fill: var(--soft); font-size: 11px; }
.matched { fill-opacity: .16; stroke-width: 1.6; }
.alone { fill: #9aa5b1; stroke: #9aa5b1; fill-opacity: .06; }
.alone.name { stroke: #fff; fill-opacity: 1; }
.query circle { stroke-dasharray: 4 2; }
.pairs line { stroke-width: 1.2; stroke-opacity: .45; }
.off line { stroke: #c92a2a; stroke-width: 2; }
.panel { fill: #fbfcfd; stroke: var(--rule); }
.panel-title { font-size: 12.5px; font-weight: 700; fill: var(--ink); }
.legend { display: flex; flex-wrap: wrap; gap: 2px 16px; margin: 6px 0; font-size: 12.5px; color: var(--soft); }
.legend span { display: inline-flex; align-items: center; gap: 6px; white-space: nowrap; }
.legend i { display: inline-block; width: 16px; height: 0; border-top: 3px solid; }
.legend i.dash { border-top: 2px dashed; }
.legend i.dot { width: 9px; height: 9px; border: 0; border-radius: 50%; background: currentColor; }
.legend i.ring { width: 12px; height: 12px; border: 2px solid; border-radius: 50%; }
.legend i.cross { width: 10px; height: 12px; border: 0; }
.legend i.cross::before { content: "\d7"; font: 700 17px/12px sans-serif; }
table { border-collapse: collapse; width: 100%; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { padding: 4px 10px; border-bottom: 1px solid var(--rule); text-align: left; }
th { color: var(--soft); font-weight: 600; cursor: pointer; white-space: nowrap; }
th:hover { color: var(--accent); }
th[aria-sort=ascending]::after { content: " \2191"; }
th[aria-sort=descending]::after { content: " \2193"; }
td.number, th.number { text-align: right; }
td { white-space: nowrap; }
#loops td { white-space: normal; }
th:first-child, td:first-child { padding-left: 0; }
.pick { cursor: pointer; }
.pick:hover, .pick.shown { stroke: #111; stroke-width: 2; }
.choice { display: flex; flex-wrap: wrap; gap: 8px; align-items: center; margin: 14px 0 6px; }
.choice h3 { margin: 0 8px 0 0; font-size: 15px; }
.script-only { display: none; }
.with-script .script-only { display: flex; gap: 6px; }
select, button { font: inherit; color: inherit; background: var(--paper); border: 1px solid #cbd2d9; border-radius: 6px;
  padding: 3px 8px; }
button { cursor: pointer; }
footer { margin: 16px 4px 0; color: var(--soft); font-size: 12.5px; }
@media (max-width: 820px) {
  .pair { grid-template-columns: 1fr; }
  section { padding: 14px 12px; }
  .tile { flex-basis: 120px; }
}
)css";

constexpr const char* kScript = R"js(
document.documentElement.classList.add('with-script');
document.querySelectorAll('table.sortable th').forEach(head => {
  head.addEventListener('click', () => {
    const table = head.closest('table'), body = table.tBodies[0];
    const index = [...head.parentNode.children].indexOf(head);
    const down = head.getAttribute('aria-sort') !== 'descending' && head.hasAttribute('aria-sort');
    const value = row => row.cells[index].textContent;
    const isNumber = head.classList.contains('number');
    const rows = [...body.rows].sort((a, b) => isNumber ? (parseFloat(value(a)) || 0) - (parseFloat(value(b)) || 0)
                                                        : value(a).localeCompare(value(b)));
    if (down) rows.reverse();
    table.querySelectorAll('th').forEach(other => other.removeAttribute('aria-sort'));
    head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
    body.append(...rows);
  });
});
const loops = document.getElementById('loop-choice'), picture = document.getElementById('loop-picture');
function showLoop(number) {
  const kept = document.getElementById('loop-' + number);
  if (!kept) return;
  picture.replaceChildren(kept.content.cloneNode(true));
  loops.value = number;
  document.querySelectorAll('.pick').forEach(dot => dot.classList.toggle('shown', dot.dataset.loop === String(number)));
}
if (loops) {
  loops.addEventListener('change', () => showLoop(loops.value));
  const step = by => {
    const option = loops.options[loops.selectedIndex + by];
    if (option) showLoop(option.value);
  };
  document.getElementById('loop-before').addEventListener('click', () => step(-1));
  document.getElementById('loop-after').addEventListener('click', () => step(1));
  document.querySelectorAll('.pick').forEach(dot => dot.addEventListener('click', () => showLoop(dot.dataset.loop)));
  showLoop(loops.value);
}
)js";

bool is_number(const std::string& cell) { return cell.empty() || parse_double(cell).has_value(); }

}  // namespace

std::string page(const std::string& title, const std::string& body) {
  return "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
         "<link rel=\"icon\" href=\"data:,\">\n<title>" +
         escaped(title) + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n<main>\n" + body +
         "</main>\n<script>" + kScript + "</script>\n</body>\n</html>\n";
}

std::string section(const std::string& id, const std::string& heading, const std::string& note,
                    const std::string& content) {
  return "<section id=\"" + id + "\">\n<h2>" + escaped(heading) + "</h2>\n" +
         (note.empty() ? std::string() : "<p>" + note + "</p>\n") + content + "</section>\n";
}

std::string HtmlTable::html() const {
  std::vector<const char*> classes;
  for (std::size_t i = 0; i < columns_.size(); ++i) {
    const bool is_right =
        !rows_.empty() && std::all_of(rows_.begin(), rows_.end(), [i](const auto& row) { return is_number(row[i]); });
    classes.push_back(is_right ? " class=\"number\"" : "");
  }
  const auto line = [&classes](const char* tag, const std::vector<std::string>& cells) {
    std::string html = "<tr>";
    for (std::size_t i = 0; i < cells.size(); ++i) {
      html += std::string("<") + tag + classes[i] + ">" + escaped(cells[i]) + "</" + tag + ">";
    }
    return html + "</tr>\n";
  };
  std::string html = "<table class=\"sortable\">\n<thead>" + line("th", columns_) + "</thead>\n<tbody>\n";
  for (const auto& row : rows_) html += line("td", row);
  return html + "</tbody>\n</table>\n";
}

std::string tile(const std::string& figure, const std::string& meaning) {
  return "<div class=\"tile\"><b>" + escaped(figure) + "</b><span>" + escaped(meaning) + "</span></div>\n";
}

}  // namespace semantic_topo_loop::core
