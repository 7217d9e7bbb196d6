// Light or dark: as the system says, or as chosen with the button, remembered by this browser.
// A classic script in <head>, so that the page never flashes in the wrong colours.
(() => {
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const chosen = () => {
    try {
      return localStorage.getItem("theme");
    } catch {
      return null; // storage may be blocked
    }
  };

  function apply() {
    root.dataset.theme = chosen() ?? (dark.matches ? "dark" : "light");
    const button = document.getElementById("theme");
    if (button) {
      const other = root.dataset.theme === "dark" ? "light" : "dark";
      button.textContent = other === "dark" ? "Dark" : "Light";
      button.setAttribute("aria-label", `Use ${other} colours`);
    }
    document.dispatchEvent(new Event("themechange"));
  }

  apply();
  dark.addEventListener("change", apply);
  document.addEventListener("DOMContentLoaded", () => {
    apply();
    document.getElementById("theme")?.addEventListener("click", () => {
      const other = root.dataset.theme === "dark" ? "light" : "dark";
      try {
        // Choosing what the system says anyway follows the system again.
        if (other === (dark.matches ? "dark" : "light")) localStorage.removeItem("theme");
        else localStorage.setItem("theme", other);
      } catch {
        root.dataset.theme = other;
      }
      apply();
    });
  });
})();
