// Motions play in the place of their stills: when they are clicked, the one of the first
// page when it is seen. One at a time, since each draws all the while it is there.
"use strict";
(() => {
  let playing = null; // the frame, and the still that it stands for

  function stop() {
    if (playing && playing.still.isConnected) playing.frame.remove();
    else if (playing) playing.frame.replaceWith(playing.still);
    playing = null;
  }

  function play(still) {
    stop();
    const frame = document.createElement("iframe");
    // The still stays to be seen until there is something else to see.
    frame.className = "playback waiting";
    frame.title = still.title;
    frame.src = still.href;
    frame.addEventListener("load", () => {
      still.remove();
      frame.className = "playback";
    });
    still.after(frame);
    playing = { frame, still };
  }

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries.filter((each) => each.isIntersecting)) {
      seen.unobserve(entry.target);
      if (!playing) play(entry.target);
    }
  }, { threshold: 0.5 });

  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  for (const still of document.querySelectorAll("a.playback")) {
    still.addEventListener("click", (event) => {
      // With a key it opens elsewhere, as any link does.
      if (event.ctrlKey || event.metaKey || event.shiftKey) return;
      event.preventDefault();
      play(still);
    });
    if (still.dataset.play === "seen" && !calm) seen.observe(still);
  }
})();
