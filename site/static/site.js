"use strict";
// From the disk a browser may not read other pages, so the search shows titles alone.
if (location.protocol === "file:") DOCUMENTATION_OPTIONS.SHOW_SEARCH_SUMMARY = false;

// The ledger's filter, and folds that open when a link leads into them.
function startFilter(form) {
  const claims = [...document.querySelectorAll("section")].filter(
    (each) => each.querySelector(":scope > p > .badge"));
  const words = (each) => each.textContent.toLowerCase();
  function apply() {
    let left = 0;
    for (const each of claims) {
      const verdict = each.querySelector(".badge").textContent;
      const far = each.querySelector(".far").textContent;
      const fits = (!form.verdict.value || form.verdict.value === verdict)
        && (!form.far.value || form.far.value === far)
        && words(each).includes(form.words.value.toLowerCase());
      each.classList.toggle("left-out", !fits);
      left += fits;
    }
    form.querySelector("output").value = `${left} of ${claims.length} claims`;
  }
  form.hidden = false;
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  apply();
  return () => { form.reset(); apply(); };
}

function arrive(reset) {
  const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  const section = target.closest("section");
  if (target.closest(".left-out")) reset();
  const fold = target.closest("details")
    || (section && section.querySelector(":scope > p > .badge") && section.querySelector("details"));
  if (fold) fold.open = true;
  target.scrollIntoView({ behavior: "instant" });
}

// What scrolls can be reached by the keyboard, and the sidebar's headings have a level.
function reachable() {
  for (const each of document.querySelectorAll("pre, .table-wrapper, mjx-container"))
    if (each.scrollWidth > each.clientWidth) each.tabIndex = 0;
  for (const each of document.querySelectorAll("[role=heading]:not([aria-level])"))
    each.setAttribute("aria-level", "2");
}

window.addEventListener("load", reachable);
document.addEventListener("DOMContentLoaded", () => {
  const form = document.querySelector("form.filter");
  const reset = form ? startFilter(form) : () => {};
  window.addEventListener("hashchange", () => arrive(reset));
  arrive(reset);
});
