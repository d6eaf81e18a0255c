#include "cli/page.h"

namespace rigor {

const char* const kPageStyle = R"(
body{font:15px/1.45 system-ui,sans-serif;margin:0;background:#f6f6f4;color:#222}
header{background:#1f2d3a;color:#fff;padding:22px 32px}header h1{margin:0;font-size:24px}header p{margin:4px 0 0;opacity:.8}
main{max-width:1240px;margin:0 auto;padding:8px 24px 48px}
h2{margin:30px 0 8px;font-size:19px}h3{margin:0 0 6px;font-size:16px}
.tiles{display:flex;flex-wrap:wrap;gap:12px;margin-top:18px}.tile{background:#fff;border-radius:6px;padding:10px 16px;min-width:120px;box-shadow:0 1px 2px #0002}
.tile b{display:block;font-size:21px}.tile span{color:#666;font-size:13px}.bad b{color:#c0392b}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:14px}
.card{background:#fff;border-radius:6px;padding:14px 16px;box-shadow:0 1px 2px #0002}
table{border-collapse:collapse;width:100%;background:#fff}td,th{padding:4px 9px;text-align:right;border-bottom:1px solid #eee;font-variant-numeric:tabular-nums}
th{color:#666;font-weight:500}td:first-child,th:first-child{text-align:left}td.l,th.l{text-align:left}
svg{width:100%;height:auto}svg text{font-size:10.5px;fill:#555}.axis{fill:none;stroke:#999}.bar{fill:#3b6ea5}.mark{stroke:#c0392b;stroke-dasharray:3 3;fill:none}
figure{margin:0}figure img{width:100%;display:block;border-radius:4px;background:#000}figcaption{color:#666;font-size:13px;margin-top:3px}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(300px,1fr));gap:12px;margin-top:10px}
.verdict{background:#fff;border-left:5px solid #3a9a5b;border-radius:4px;margin-top:18px;padding:10px 18px;box-shadow:0 1px 2px #0002}
.verdict h2{margin:0}.verdict p{margin:2px 0}.verdict ul{margin:6px 0 0;padding:0;list-style:none}.verdict li{padding:3px 0}.verdict li b{display:inline-block;min-width:72px}
.verdict.warning{border-color:#e8a33d}.verdict.bad{border-color:#c0392b}li.note{color:#444}.verdict li.note b{color:#666}li.warning b{color:#8a5a00}li.bad b{color:#c0392b}
.none{color:#888}code{background:#eee;padding:1px 5px;border-radius:3px;word-break:break-all}.note{color:#8a5a00})";

std::string html_text(const std::string& text) {
  std::string out;
  for (char c : text) {
    if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else if (c == '"')
      out += "&quot;";
    else
      out += c;
  }
  return out;
}

}  // namespace rigor
