"use strict";
// Tables that are wider than their place say that they scroll.
(() => {
  const tell = () => {
    for (const box of document.querySelectorAll(".scroll")) {
      box.previousElementSibling.hidden = box.scrollWidth <= box.clientWidth + 1;
    }
  };
  const watch = new ResizeObserver(tell);
  document.querySelectorAll(".scroll, .scroll > table").forEach((box) => watch.observe(box));
})();
