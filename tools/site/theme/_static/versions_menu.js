// Menu of the versions that stand beside this one; ../versions.js lists them.
for (const menu of document.querySelectorAll(".versions select")) {
  const versions = window.ANGLER_VERSIONS || [];
  if (versions.length < 2) continue;
  for (const name of versions) {
    const option = document.createElement("option");
    option.value = option.textContent = name;
    option.selected = name === menu.dataset.version;
    menu.append(option);
  }
  menu.addEventListener("change", () => {
    const root = menu.dataset.root || "./";
    location.href = `${root}../${menu.value}/index.html`;
  });
  menu.closest(".versions").hidden = false;
}
