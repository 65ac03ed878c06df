// Which runs the charts show, and charts that let a finger scroll the page. Models are known when Bokeh has drawn.
"use strict";
function shown(change) {
  for (const drawn of Bokeh.documents) for (const model of drawn.all_models) change(model);
}
for (const box of document.querySelectorAll("nav input")) {
  box.addEventListener("change", () => shown((model) => {
    if (model.tags.includes(box.dataset.run)) model.visible = box.checked;
  }));
}
if (matchMedia("(pointer: coarse)").matches) {
  const free = () => Bokeh.documents.length
    ? shown((model) => { if ("active_drag" in model.attributes) model.active_drag = null; })
    : setTimeout(free, 50);
  free();
}
