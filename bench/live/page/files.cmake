# What the server serves from this folder; the files of libjs-three come beside them (docs/live.md).
set(RIGOR_LIVE_PAGE
  index.html page.css icon.svg
  main.js session.js foxglove.js cdr.js dom.js color.js
  channels.js picture_view.js picture.js cloud_view.js cloud.js frames_view.js plot_view.js plot.js history.js timeline.js table_view.js
  run_panel.js verdict.js histogram.js pair_panel.js estimate_panel.js expect_panel.js message_keeper.js splitter.js fault_panel.js fault_kinds.js event_log.js
  world_panel.js world_map.js node_panel.js)
