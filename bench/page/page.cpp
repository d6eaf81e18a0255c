#include "bench/page/page.h"

#include <fmt/format.h>

namespace rigor {
namespace {

// Colours are variables, so that dark mode is one block. Series are told apart for colour-blind readers too
// (Okabe and Ito's palette, darkened or lightened for contrast with the ground).
const char* const kStyle = R"(
:root{color-scheme:light dark;--ground:#f6f6f4;--surface:#fff;--ink:#222;--quiet:#5c5c5c;--rule:#e2e2de;--head:#1f2d3a;--code:#eee;
--good:#2f8550;--warn:#e8a33d;--warn-ink:#8a5a00;--bad:#c0392b;--never:#b5b5b5;--band:#dfe8f2;--alarm:#f8e0dc;
--series-1:#3b6ea5;--series-2:#c0392b;--series-3:#2e8557;--series-4:#7a4fa3;--series-5:#b5760a}
@media(prefers-color-scheme:dark){:root{--ground:#15181b;--surface:#1f2428;--ink:#e4e4e0;--quiet:#a3a8ab;--rule:#353b40;--head:#0f1418;--code:#2c3237;
--good:#4fb477;--warn:#e8a33d;--warn-ink:#f0bd6a;--bad:#f0776a;--never:#6d7276;--band:#2a3b4d;--alarm:#4d2c29;
--series-1:#7fb2e8;--series-2:#f0897d;--series-3:#6fcf97;--series-4:#c39be6;--series-5:#e8b04f}}
*{box-sizing:border-box}body{font:15px/1.45 system-ui,sans-serif;margin:0;background:var(--ground);color:var(--ink)}
header{background:var(--head);color:#fff;padding:22px 32px}header h1{margin:0;font-size:24px}header p{margin:4px 0 0;opacity:.85;overflow-wrap:anywhere}
main{max-width:1240px;margin:0 auto;padding:8px 24px 48px}a{color:var(--series-1)}
h2{margin:30px 0 8px;font-size:19px}h3{margin:0 0 6px;font-size:16px}
.tiles{display:flex;flex-wrap:wrap;gap:12px;margin-top:18px}.tile{background:var(--surface);border-radius:6px;padding:10px 16px;min-width:120px;box-shadow:0 1px 2px #0002}
.tile b{display:block;font-size:21px}.tile span{color:var(--quiet);font-size:13px}.bad b{color:var(--bad)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr));gap:14px;align-items:start}
.card{background:var(--surface);border-radius:6px;padding:14px 16px;box-shadow:0 1px 2px #0002;min-width:0}
.wide{overflow-x:auto}.wide td,.wide th{white-space:nowrap}.wide td:nth-child(2){white-space:normal}table{border-collapse:collapse;width:100%;background:var(--surface)}td,th{padding:4px 9px;text-align:right;border-bottom:1px solid var(--rule);font-variant-numeric:tabular-nums}
th{color:var(--quiet);font-weight:500}th[title]{text-decoration:underline dotted;cursor:help}td:first-child,th:first-child{text-align:left}td.l,th.l{text-align:left}
td.bad{color:var(--bad);font-weight:600}td.warning{color:var(--warn-ink);font-weight:600}
.facts td{text-align:left;overflow-wrap:anywhere}.facts td:first-child{color:var(--quiet);white-space:nowrap}
main svg:not(.data){width:100%;height:auto}svg text{font-size:10.5px;fill:var(--quiet)}.axis{fill:none;stroke:var(--quiet)}.bar{fill:var(--series-1)}.bar.beyond{fill:var(--bad)}
.mark{stroke:var(--series-2);stroke-dasharray:3 3;fill:none}.limit{stroke:var(--bad);fill:none}.grid{stroke:var(--rule)}.region{fill:var(--alarm)}
svg.plot{touch-action:pan-y;user-select:none;-webkit-user-select:none;cursor:crosshair}svg.plot:focus-visible{outline:2px solid var(--series-1)}.cursor{stroke:var(--quiet);stroke-dasharray:2 2}.chosen{fill:var(--series-1);opacity:.2}
.status-fresh{fill:var(--good)}.status-overdue{fill:var(--warn)}.status-disconnected{fill:var(--bad)}.status-never{fill:var(--never)}
#values{position:absolute;z-index:2;pointer-events:none;background:var(--surface);border:1px solid var(--rule);border-radius:4px;padding:3px 8px;font-size:12px;font-variant-numeric:tabular-nums;box-shadow:0 2px 6px #0004;white-space:pre}
figure{margin:0}figure img{width:100%;display:block;border-radius:4px;background:#000}figcaption,.words{color:var(--quiet);font-size:13px;margin-top:3px}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(300px,100%),1fr));gap:12px;margin-top:10px}
.verdict{background:var(--surface);border-left:5px solid var(--good);border-radius:4px;margin-top:18px;padding:10px 18px;box-shadow:0 1px 2px #0002}
.verdict h2{margin:0}.verdict p{margin:2px 0}.verdict ul{margin:6px 0 0;padding:0;list-style:none}.verdict li{padding:3px 0;overflow-wrap:anywhere}.verdict li b{display:inline-block;min-width:72px}
.verdict.warning{border-color:var(--warn)}.verdict.bad{border-color:var(--bad)}.verdict li.note,.verdict li.note b{color:var(--quiet)}li.warning b{color:var(--warn-ink)}li.bad b{color:var(--bad)}
.none{color:var(--quiet)}code{background:var(--code);padding:1px 5px;border-radius:3px;word-break:break-all}.note{color:var(--warn-ink)}
@media(max-width:640px){header{padding:14px 12px}main{padding:4px 10px 32px}}
@media print{#values{display:none}.card{break-inside:avoid}})";

// Makes the plots that svg.h draws answer to a pointer and to keys: values under the cursor, a dragged range
// enlarged, all plots over time alike. Without scripts the plots are as they are drawn.
const char* const kScript = R"(
const NS="http://www.w3.org/2000/svg",tip=document.body.appendChild(document.createElement("div"));
tip.id="values";tip.hidden=true;
const make=(parent,tag,names,text="")=>{const e=document.createElementNS(NS,tag);for(const k in names)e.setAttribute(k,names[k]);e.textContent=text;return parent.appendChild(e)};
const short=(v)=>String(Number(v.toPrecision(4))).replace("-","\u2212");
const duration=(ns)=>{const [k,u]=ns<1e3?[1,"ns"]:ns<1e6?[1e3,"\u00b5s"]:ns<1e9?[1e6,"ms"]:[1e9,"s"];return short(ns/k)+" "+u};
class Plot{
  constructor(svg){
    this.svg=svg;this.data=svg.querySelector("svg.data");
    [this.left,this.top,this.width,this.height]=svg.dataset.frame.split(" ").map(Number);
    [this.x0,this.x1,this.y0,this.y1]=svg.dataset.range.split(" ").map(Number);
    this.axis=svg.dataset.axis;this.from=this.x0;this.to=this.x1;
    this.lines=[...this.data.querySelectorAll("polyline[data-name]")].map((l)=>({name:l.dataset.name,p:l.getAttribute("points").trim().split(/\s+/).map((q)=>q.split(",").map(Number))}));
    this.spans=[...this.data.querySelectorAll("[data-span]")].map((e)=>[...e.dataset.span.split(" ").map(Number),e.querySelector("title").textContent]);
    this.line=make(svg,"path",{class:"cursor",visibility:"hidden"});this.chosen=make(svg,"rect",{class:"chosen",y:this.top,height:this.height,visibility:"hidden"});
    svg.tabIndex=0;
    svg.addEventListener("pointerdown",(e)=>{if(e.button===0){this.start=this.at(e);if(e.pointerType==="mouse")svg.setPointerCapture(e.pointerId)}});
    svg.addEventListener("pointermove",(e)=>{const x=this.at(e);point(this,x,e);if(this.start!==undefined)this.choose(this.start,x)});
    svg.addEventListener("pointerup",(e)=>{const a=this.start,b=this.at(e);this.start=undefined;this.chosen.setAttribute("visibility","hidden");
      if(a!==undefined&&Math.abs(a-b)>0.01*(this.to-this.from))zoom(this,Math.min(a,b),Math.max(a,b))});
    svg.addEventListener("pointercancel",()=>{this.start=undefined;this.chosen.setAttribute("visibility","hidden");point(null)});
    svg.addEventListener("pointerleave",()=>point(null));
    svg.addEventListener("dblclick",()=>zoom(this,this.x0,this.x1));
    svg.addEventListener("keydown",(e)=>{const w=this.to-this.from,m=(this.from+this.to)/2;
      const to={"+":[m-w/4,m+w/4],"-":[m-w,m+w],ArrowLeft:[this.from-w/4,this.to-w/4],ArrowRight:[this.from+w/4,this.to+w/4],Escape:[this.x0,this.x1]}[e.key];
      if(to){e.preventDefault();zoom(this,...to)}});
  }
  at(e){const p=new DOMPoint(e.clientX,e.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    return this.from+(this.to-this.from)*Math.max(0,Math.min(1,(p.x-this.left)/this.width))}
  px(x){return this.left+this.width*(x-this.from)/(this.to-this.from)}
  choose(a,b){const x=this.px(Math.min(a,b));this.chosen.setAttribute("x",x);this.chosen.setAttribute("width",Math.max(0,this.px(Math.max(a,b))-x));this.chosen.setAttribute("visibility","visible")}
  show(from,to){
    const w=Math.min(to-from,this.x1-this.x0);from=Math.max(this.x0,Math.min(from,this.x1-w));
    this.from=from;this.to=from+w;const k=this.width/(this.x1-this.x0);
    this.data.setAttribute("viewBox",[this.left+(from-this.x0)*k,this.top,w*k,this.height].join(" "));
    const ticks=[...this.svg.querySelectorAll("text.x")];
    if(ticks.length){const y=ticks[0].getAttribute("y");for(const t of ticks)t.remove();
      const raw=w/5,p=10**Math.floor(Math.log10(raw)),step=p*[1,2,5,10].find((s)=>s*p>=raw*0.999);
      for(let i=Math.ceil(from/step-1e-9);i*step<=this.to+step*1e-6;i++)make(this.svg,"text",{class:"x",x:this.px(i*step),y,"text-anchor":"middle"},this.axis==="log ns"?duration(10**(i*step)):short(i*step))}
    for(const t of this.svg.querySelectorAll("text[data-x]")){const x=Number(t.dataset.x);const e=this.px(x)>this.left+this.width-30;t.setAttribute("x",this.px(x)+(e?-3:3));t.setAttribute("text-anchor",e?"end":"start");t.setAttribute("visibility",x<from||x>this.to?"hidden":"visible")}
  }
  words(x){
    const out=[this.axis==="log ns"?duration(10**x):short(x)+" s"],px=this.left+this.width*(x-this.x0)/(this.x1-this.x0);
    for(const l of this.lines){let i=0,j=l.p.length-1;while(j-i>1){const m=(i+j)>>1;if(l.p[m][0]<=px)i=m;else j=m}
      const q=Math.abs(l.p[i][0]-px)<=Math.abs(l.p[j][0]-px)?l.p[i]:l.p[j];
      out.push(l.name+"  "+short(this.y1-(this.y1-this.y0)*(q[1]-this.top)/this.height))}
    for(const [a,b,t] of this.spans)if(x>=a&&x<b)out.push(t);
    return out.join("\n");
  }
}
const plots=[...document.querySelectorAll("svg.plot")].map((s)=>new Plot(s)),
  alike=(p)=>p.axis==="time"?plots.filter((q)=>q.axis==="time"):[p];
function zoom(p,a,b){if(b-a>1e-6*(p.x1-p.x0))for(const q of alike(p))if(a<q.x1&&b>q.x0)q.show(a,b)}
function point(p,x,e){
  for(const q of plots)q.line.setAttribute("visibility","hidden");
  tip.hidden=!p;if(!p)return;
  for(const q of alike(p))if(x>=q.from&&x<=q.to){q.line.setAttribute("d",`M${q.px(x)} ${q.top}v${q.height}`);q.line.setAttribute("visibility","visible")}
  tip.textContent=p.words(x);
  const w=document.documentElement.clientWidth;
  tip.style.left=Math.max(4,Math.min(e.clientX+14,w-tip.offsetWidth-4))+scrollX+"px";tip.style.top=e.clientY+14+scrollY+"px";
}
)";

}  // namespace

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

std::string html_page(const std::string& title, const std::string& subtitle, const std::string& body) {
  return fmt::format(
      "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
      "content=\"width=device-width,initial-scale=1\"><meta name=\"color-scheme\" content=\"light dark\">"
      "<title>{0} – Rigor</title><style>{1}</style></head><body><header><h1>{0}</h1>{2}</header>"
      "<main>{3}</main><script type=\"module\">{4}</script></body></html>\n",
      html_text(title), kStyle, subtitle.empty() ? "" : "<p>" + subtitle + "</p>", body, kScript);
}

}  // namespace rigor
