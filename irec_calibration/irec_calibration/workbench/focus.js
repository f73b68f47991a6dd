// Where a control that has the focus is drawn anew, the new one gets the focus; the keyboard must not fall back to the page's top.
(() => {
  const named = (e) => e.closest?.("[data-testid]")?.dataset.testid;
  let last = null;
  const remember = (e) => { if (e.target !== document.body) last = { element: e.target, name: named(e.target) }; };
  document.addEventListener("focusin", remember);
  document.addEventListener("pointerdown", (e) => { if (!e.target.closest?.("button, input, [tabindex]")) last = null; });
  const focus = (name) => {
    const found = document.querySelector(`[data-testid="${CSS.escape(name)}"]`);
    const target = found?.matches("button, input, [tabindex]") ? found : found?.querySelector("button, input, [tabindex]");
    if (target && !target.disabled) target.focus({ preventScroll: true });
  };
  // to be called where what had the focus is gone for good
  window.irecFocus = (name) => {
    const now = document.activeElement;
    if (!now || now === document.body || !now.isConnected || now.offsetParent === null) focus(name);
  };
  new MutationObserver(() => {
    if (last?.name && !last.element.isConnected && (!document.activeElement || document.activeElement === document.body)) focus(last.name);
  }).observe(document.body, { childList: true, subtree: true });
  // a figure on a tab that is not shown is asked to resize in vain; it is resized when its tab is shown
  window.addEventListener("unhandledrejection", (e) => { if (`${e.reason?.message ?? e.reason}`.startsWith("Resize must be passed")) e.preventDefault(); });
})();
