// The scene that the page brings along: its description, and its shaders, and its data, unpacked by a worker.

const textOf = (id) => document.getElementById(id).textContent;

export const scene = JSON.parse(textOf("scene"));

// Adds the shaders to the description: texts by file name, and lines of options.
export async function readShaders() {
  const bytes = Uint8Array.from(atob(textOf("shaders")), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  scene.shaders = await new Response(stream).json();
}

// The textures' bytes; see decode.js. onProgress: called with the share that is done.
export function unpack(onProgress) {
  const source = new Blob([textOf("worker")], { type: "text/javascript" });
  const worker = new Worker(URL.createObjectURL(source));
  const data = textOf("data").trim();
  document.getElementById("data").remove(); // as large as the scene
  return new Promise((resolve, reject) => {
    worker.onerror = (event) => reject(new Error(event.message || "the scene could not be unpacked"));
    worker.onmessage = ({ data: answer }) => {
      if (answer.progress !== undefined) return onProgress(answer.progress);
      worker.terminate();
      if (answer.error) reject(new Error(answer.error));
      else resolve(answer);
    };
    worker.postMessage({ data, scene });
  });
}
