// Figures that are enlarged by a click, and commands that are copied by one.

{
  const dialog = document.createElement("dialog");
  const close = Object.assign(document.createElement("button"), { type: "button", textContent: "Close" });
  const large = document.createElement("img");
  dialog.append(close, large);
  dialog.className = "large";
  document.body.append(dialog);
  // A click anywhere closes it again; one that ends a selection or a drag of the scroll bar is none on the picture.
  dialog.addEventListener("click", () => dialog.close());
  for (const figure of document.querySelectorAll("figure")) {
    const image = figure.querySelector("img"), button = figure.querySelector(".enlarge");
    const enlarge = () => {
      large.src = image.src;
      large.alt = image.alt;
      dialog.style.cssText = figure.style.cssText;
      dialog.setAttribute("aria-label", image.alt);
      dialog.showModal();
    };
    button.hidden = false;
    button.addEventListener("click", enlarge);
    image.addEventListener("click", enlarge);
  }
}

for (const command of document.querySelectorAll(".command")) {
  const text = command.querySelector("code");
  const button = Object.assign(document.createElement("button"), { type: "button", className: "copy", textContent: "Copy" });
  button.setAttribute("aria-label", `Copy: ${command.querySelector("span").textContent}`);
  button.addEventListener("click", async () => {
    let done = true;
    try {
      await navigator.clipboard.writeText(text.textContent);
    } catch (problem) {
      // Without the clipboard's permission the text is at least selected, and often copied.
      getSelection().selectAllChildren(text);
      done = document.execCommand("copy");
    }
    button.textContent = done ? "Copied" : "Selected";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
  command.append(button);
}
