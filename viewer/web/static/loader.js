// Unpacks the page's description, and runs the script of the page that it holds; says so where the browser is too old for either.
globalThis.snerg = {
  // The description in a page: this one, or a newer one.
  async read(page = document) {
    if (!("DecompressionStream" in window)) throw new Error("This browser is too old. Try a current Chrome, Edge, Firefox or Safari.");
    const bytes = Uint8Array.from(atob(page.getElementById("scene").textContent), (character) => character.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
  },

  fail(message) {
    document.getElementById("notice").className = "failed";
    document.getElementById("notice-title").textContent = "This scene cannot be shown";
    document.getElementById("notice-text").textContent = message;
  },

  // Resolves once the scene is shown.
  async open() {
    const description = await this.read();
    document.body.append(Object.assign(document.createElement("script"), { textContent: description.script }));
    return globalThis.snerg.start(description); // of the script's own snerg, main.js
  },
};
globalThis.snerg.ready = globalThis.snerg.open();
globalThis.snerg.ready.catch((error) => globalThis.snerg.fail(error.message));
