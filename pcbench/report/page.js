"use strict";
// Tables and figures that are wider than the window get a hint.
function hints() { for (const box of document.querySelectorAll(".wide, .picture")) box.classList.toggle("scrolls", box.scrollWidth > box.clientWidth + 1); }
addEventListener("resize", hints);
hints();
