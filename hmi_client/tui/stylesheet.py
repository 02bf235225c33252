"""How the text client looks: sizes, borders and colours of its panels."""

CSS = """
Screen { background: $fp-back; color: $fp-text; }
SiteView { height: 1fr; }
#sites { height: 1; }
#body { height: 1fr; }
#map, #matrix, #list, .image {
    background: $fp-back;
    border: round $fp-border;
    border-title-color: $fp-focus;
    border-subtitle-color: $fp-dim;
}
#map { width: 1fr; min-width: 22; }
#middle { width: 1.3fr; min-width: 26; }
#matrix {
    height: 2fr;
    scrollbar-size: 1 1;
    scrollbar-background: $fp-back;
    scrollbar-color: $fp-border;
}
#list { height: 1fr; min-height: 5; }
#images { width: 2fr; layout: vertical; }
.image { width: 1fr; height: 1fr; border: round $fp-red-border; border-title-color: $fp-red-text; }
#map:focus, #matrix:focus, #list:focus { border: heavy $fp-focus; }
.image:focus { border: heavy $fp-red-focus; }
.maximised #map, .maximised #middle { display: none; }
.maximised #images { layout: horizontal; }
.overview #map, .overview #list, .overview #images { display: none; }
#status { height: 3; }
.narrow #status { height: 4; }
#keys { height: 1; dock: bottom; }
#play { height: 1; }
ToastRack { align: left bottom; }
Page { align: center middle; }
#page {
    width: 90%;
    height: 80%;
    background: $fp-back;
    color: $fp-text;
    border: heavy $fp-focus;
    border-title-color: $fp-focus;
    border-subtitle-color: $fp-dim;
    padding: 0 1;
}
"""
