// A figure of several panels is small on a phone: a click opens it by itself.
document.querySelectorAll(".bd-article img").forEach((image) => {
  if (image.closest("a, .sd-card, .hero")) return;
  const link = document.createElement("a");
  link.href = image.src;
  link.className = "figure-link";
  link.title = "Open the figure by itself";
  image.replaceWith(link);
  link.append(image);
});
