// Links to files: plain ones, or, where the service has API keys, fetched with the key.

export function download(link, path, name, media) {
  link.href = path;
  link.setAttribute("download", name);
  link.addEventListener("click", async (event) => {
    event.preventDefault();
    const headers = { Accept: media };
    const key = sessionStorage.getItem("api-key");
    if (key) headers["X-API-Key"] = key;
    const answer = await fetch(path, { headers });
    if (!answer.ok) return;
    const address = URL.createObjectURL(await answer.blob());
    const file = document.createElement("a");
    file.href = address;
    file.download = name;
    file.click();
    setTimeout(() => URL.revokeObjectURL(address), 10_000);
  });
}
